"""The page: a server on this machine with the scene, the controls and the plots."""

import contextlib
import errno
import io
import secrets
import socket
from math import isfinite

import viser

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.platform import Platform
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.viewer.events import ClientDisconnected
from omniman_ros.viewer.page.inputs import Post
from omniman_ros.viewer.page.panel import Controls, StatusPanel
from omniman_ros.viewer.page.plots import Plots
from omniman_ros.viewer.page.request_guard import RequestGuard
from omniman_ros.viewer.page.scene import PageScene
from omniman_ros.viewer.page.viser_compat import LocalServer, guarded_server, restrict_to_values
from omniman_ros.viewer.page_access import PageAccess
from omniman_ros.viewer.style import PANEL_WIDTH
from omniman_ros.viewer.view_state import ViewState

MAX_PORTS = 20  #: Number of ports that are tried, starting with the requested one
TOKEN_BYTES = 24  #: Number of random bytes of a token
PERCEIVED_INTERVAL = 2  #: Frames between two updates of scan, tracks and the robot's shapes
LINES_INTERVAL = 5  #: Number of frames between two updates of the lines on the floor
PLOTS_INTERVAL = 4  #: Number of frames between two updates of plots and texts
#: Errors of binding to an address that is not one of this machine
_FOREIGN_HOST_ERRORS = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT, errno.EINVAL)


def free_port(host: str, port: int) -> int:
    """Return the requested port, or the next free one; none at all raises a ParameterError."""
    for candidate in range(port, min(port + MAX_PORTS, 65536)):
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
            except socket.gaierror as error:
                raise ParameterError("host", host, f"has no address: {error.strerror}") from error
            except OverflowError as error:
                raise ParameterError("port", port, str(error)) from error
            except OSError as error:
                if error.errno in _FOREIGN_HOST_ERRORS:
                    raise ParameterError("host", host, error.strerror or "") from error
                continue
            return int(probe.getsockname()[1])
    raise ParameterError("port", port, f"this port and the next {MAX_PORTS - 1} are in use")


class Page:
    """The page, for any number of browsers.

    Its server runs in a thread of its own. Drawing writes to a buffer that keeps only the latest
    values, so that a slow browser delays nobody. The server's thread passes the events of the
    browsers to `post`.

    Args:
        mount: Mount of its arm; None if the robot has no arm.
        limits: Largest speed [m/s] and yaw rate [rad/s] of the motion buttons.

    Raises:
        ParameterError: The host, the port, or the files for https cannot be used.
    """

    def __init__(
        self,
        robot: Platform,
        mount: Mount | None,
        constraints: int,
        limits: tuple[float, float],
        access: PageAccess,
        post: Post,
    ) -> None:
        host, port, tls = access.host, free_port(access.host, access.port), access.tls()
        self._token = access.token or (
            secrets.token_urlsafe(TOKEN_BYTES) if access.needs_token else ""
        )
        self._scheme = "http" if tls is None else "https"
        guard = RequestGuard(host, port, self._token, is_encrypted=tls is not None)
        # viser would print a box on stdout; the node logs the address.
        with guarded_server(guard, tls), contextlib.redirect_stdout(io.StringIO()):
            self._server = LocalServer(host=host, port=port, label="omniman", verbose=False)
        restrict_to_values(self._server)
        self._limits = limits
        self._frames = 0
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium"
        )
        self._scene = PageScene(self._server, robot, mount, post)
        self._controls = Controls(self._server, limits, self._scene.clicks, post)
        self._plots = Plots(self._server, robot.wheels.names, constraints, robot.motor.max_voltage)
        self._status = StatusPanel(self._server, self._plots.panel)
        self._plots.panel.set_width(PANEL_WIDTH)

        @self._server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            post(ClientDisconnected(client.client_id))

    @property
    def link(self) -> str:
        """URL of the page with its token, if it has one: who knows it can drive the robot."""
        return f"{self.address}/?token={self._token}" if self._token else self.address

    @property
    def address(self) -> str:
        """URL of the page, without its token."""
        host = self._server.get_host()
        name = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, host)
        name = f"[{name}]" if ":" in name else name
        return f"{self._scheme}://{name}:{self._server.get_port()}"

    @property
    def watched(self) -> bool:
        """Whether a browser is connected."""
        return bool(self._server.get_clients())

    @property
    def layers(self) -> frozenset[str]:
        """Names of the layers that are drawn."""
        return self._controls.layers

    @property
    def speeds(self) -> tuple[float, float]:
        """Speed [m/s] and yaw rate [rad/s] of the motion buttons, within the limits."""
        speed, yaw_rate = (
            min(max(value, 0.0), limit) if isfinite(value) else 0.0
            for value, limit in zip(self._controls.speeds, self._limits, strict=True)
        )
        return speed, yaw_rate

    def draw(self, state: ViewState, now: float) -> None:
        """Draw the next frame, at a time on the clock of `state` [s]."""
        with self._server.atomic():
            self._scene.draw(state, self._controls.follow)
            if self._frames % PERCEIVED_INTERVAL == 0:
                self._scene.draw_perceived(state, self.layers)
            if self._frames % LINES_INTERVAL == 0:
                self._scene.draw_lines(state)
            if self._frames % PLOTS_INTERVAL == 0:
                self._controls.draw(state, now)
                self._status.draw(state, now)
                self._plots.draw(state, now)
        self._frames += 1

    def draw_status(self, state: ViewState, now: float) -> None:
        """Draw the robot's state in words, at a time on the clock of `state` [s]."""
        with self._server.atomic():
            self._status.draw(state, now)

    def close(self) -> None:
        """Stop the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
