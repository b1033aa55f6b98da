"""The page: a server on this machine, the scene, the controls and the plots."""

import contextlib
import errno
import io
import socket
from math import isfinite

import viser
from viser._messages import GuiUpdateMessage

from omniman_ros.core.body.model import Mount
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.robot import Robot
from omniman_ros.viewer.buttons import Post
from omniman_ros.viewer.events import Gone
from omniman_ros.viewer.guard import guarding
from omniman_ros.viewer.panel import WIDTH, Controls, Status
from omniman_ros.viewer.plots import Plots
from omniman_ros.viewer.scene import Scene
from omniman_ros.viewer.state import Picture

TRIED = 20
"""Ports that are tried, from the one asked for on."""
LINES_EVERY = 5
"""Frames from one drawing of the lines on the floor to the next."""
PLOTS_EVERY = 4
"""Frames from one drawing of plots and words to the next."""
_NOT_OURS = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT, errno.EINVAL)


def free_port(host: str, port: int) -> int:
    """The port that was asked for, or the next that is free.

    Raises:
        ParameterError: `host` is no address of this machine, or all ports are taken.
    """
    for candidate in range(port, min(port + TRIED, 65536)):
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
            except socket.gaierror as error:
                raise ParameterError("host", host, f"no address: {error.strerror}") from error
            except OverflowError as error:
                raise ParameterError("port", port, str(error)) from error
            except OSError as error:
                if error.errno in _NOT_OURS:
                    raise ParameterError("host", host, error.strerror or "") from error
                continue
            return int(probe.getsockname()[1])
    raise ParameterError("port", port, f"this one and the next {TRIED - 1} are taken")


class _Server(viser.ViserServer):
    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: a page that moves a robot is not put on the internet by a click."""
        return None


def _take_values_only(server: viser.ViserServer) -> None:
    """Let browsers set values: viser would set any attribute of a control, and so remove Stop."""
    gui = server.gui
    handle = gui._handle_gui_updates

    async def handle_values(client: int, message: GuiUpdateMessage) -> None:
        if set(message.updates) <= {"value"}:
            await handle(client, message)

    gui._websock_interface.unregister_handler(GuiUpdateMessage, handle)
    gui._websock_interface.register_handler(GuiUpdateMessage, handle_values)


class Page:
    """One page, for any number of browsers.

    Its server runs in a thread of its own. What is drawn goes to a buffer that keeps the last
    value of everything, so that a slow browser costs nobody time; what browsers send goes to
    `post`, from that thread.

    Args:
        robot: What it looks like.
        mount: Where its arm stands; None for a robot without one.
        constraints: Number of coupling errors.
        limits: Largest speed [m/s] and yaw rate [rad/s] to drive with.
        host: Address to serve on.
        port: Port, or the first of those that are tried.
        post: Where events go; must not block.

    Raises:
        ParameterError: Host or port cannot be used.
    """

    def __init__(
        self, robot: Robot, mount: Mount | None, constraints: int,
        limits: tuple[float, float], host: str, port: int, post: Post,
    ) -> None:  # fmt: skip
        chosen = free_port(host, port)
        # viser would greet on stdout with a box; the node says the address in its log.
        with guarding(host), contextlib.redirect_stdout(io.StringIO()):
            self._server = _Server(host=host, port=chosen, label="omniman", verbose=False)
        _take_values_only(self._server)
        self._limits = limits
        self._frames = 0
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium"
        )
        self._scene = Scene(self._server, robot, mount, post)
        self._controls = Controls(self._server, limits, post)
        self._plots = Plots(self._server, robot.wheels.names, constraints, robot.motor.max_voltage)
        self._status = Status(self._server, self._plots.panel)
        self._plots.panel.set_width(WIDTH)

        @self._server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            post(Gone(client.client_id))

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host = self._server.get_host()
        named = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, host)
        named = f"[{named}]" if ":" in named else named
        return f"http://{named}:{self._server.get_port()}"

    @property
    def watched(self) -> bool:
        """Whether a browser is there."""
        return bool(self._server.get_clients())

    @property
    def speeds(self) -> tuple[float, float]:
        """Speed [m/s] and yaw rate [rad/s] of the buttons, within the limits."""
        return tuple(  # type: ignore[return-value]
            min(max(value, 0.0), limit) if isfinite(value) else 0.0
            for value, limit in zip(self._controls.speeds, self._limits, strict=True)
        )

    def draw(self, picture: Picture, now: float) -> None:
        """Show the next frame, at a time [s]."""
        with self._server.atomic():
            self._scene.draw(picture, self._controls.follow)
            if self._frames % LINES_EVERY == 0:
                self._scene.draw_lines(picture)
            if self._frames % PLOTS_EVERY == 0:
                self._controls.draw(picture, now)
                self._status.draw(picture, now)
                self._plots.draw(picture, now)
        self._frames += 1

    def close(self) -> None:
        """End the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
