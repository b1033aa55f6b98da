"""Everything that relies on private parts of viser 1.1 or on the mark-up of its client.

Written for viser 1.1.1 and websockets 16.1 (`setup.py` pins `viser==1.1.*`); check each item below
when either is updated. viser 1.1 offers no public way for any of them:

* `guarded_server`: a check of the requests before viser accepts them, encryption, and a pace for
  the messages of each connection. viser calls `websockets.asyncio.server.serve` with its own
  `process_request`, and without TLS; it reads each message by `recv` and queues what to do.
* `restrict_to_values`: viser lets a browser set any attribute of a control.
* `LocalServer`: viser lets a browser request a public URL.
* * `camera_position`: viser raises an AssertionError while a camera is unknown.
* `element_id`: the id of a control's element in the page.
* * `script_html`: JavaScript in the page; viser's messages for that are private.
* `*_css`: the layout of panels and buttons, which only style sheets can change.
"""

import asyncio
import http
import ssl
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import viser
import websockets.asyncio.server
from viser._messages import GuiUpdateMessage
from viser.infra import ClientId
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from omniman_ros.viewer.page.message_pace import MessagePace
from omniman_ros.viewer.page.request_guard import RequestGuard

#: Returns the response that rejects a request, or None to accept it
RequestHandler = Callable[[ServerConnection, Request], Response | None]

PLOT_CSS = (
    ".uplot .u-title{font-size:0.75em!important;padding:2px 0 0!important}"
    ".uplot-container{margin-block:0.3em!important;padding:0!important}"
)  #: CSS that makes titles and margins of viser's plots smaller
#: CSS that hides the bar that folds the panels at the right: Stop would be folded with them
FIXED_DOCK_CSS = '[data-dock-region-handle="right"]{display:none!important}'


class LocalServer(viser.ViserServer):
    """A server that a browser cannot put on the internet."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None: a page that moves a robot must not be made public by a click."""
        return None


class PacedConnection(ServerConnection):
    """A connection whose messages are read at a limited rate.

    What a page sends beyond that waits in its own connection, and delays no other page.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._pace = MessagePace()

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next message, not before it may be read."""
        delay = self._pace.delay(self.loop.time())
        if delay > 0.0:
            await asyncio.sleep(delay)
        return await super().recv(decode)


@contextmanager
def guarded_server(guard: RequestGuard, tls: ssl.SSLContext | None = None) -> Iterator[None]:
    """Have the servers that are started in this context check their requests and pace messages.

    viser accepts neither a check nor TLS nor a pace as an argument, so `serve` of websockets is
    replaced meanwhile.
    """
    serve = websockets.asyncio.server.serve

    def guarded_serve(*args: Any, process_request: RequestHandler, **options: Any) -> Any:
        checked = partial(_process_request, guard, process_request)
        return serve(
            *args,
            process_request=checked,
            ssl=tls,
            create_connection=PacedConnection,
            **options,
        )

    # The replacement is a function in place of a class.
    websockets.asyncio.server.serve = guarded_serve  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _process_request(
    guard: RequestGuard, handler: RequestHandler, connection: ServerConnection, request: Request
) -> Response | None:
    try:
        reason = guard.rejection_reason(request.path, request.headers)
    except (ValueError, LookupError) as error:  # not an address, or a header given twice
        reason = str(error)
    if reason:
        body = f"{reason}\n".encode(errors="replace")
        headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body))})
        return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
    response = handler(connection, request)
    cookie = guard.cookie(request.path)
    if response is not None and cookie:
        response.headers["Set-Cookie"] = cookie
    return response


def restrict_to_values(server: viser.ViserServer) -> None:
    """Let browsers change nothing but the values of controls.

    viser would set any attribute of a control, so that a browser could remove Stop for all. Its
    handler of these messages is replaced by one that discards all other updates.
    """
    gui = server.gui
    handle = gui._handle_gui_updates

    async def handle_values(client: ClientId, message: GuiUpdateMessage) -> None:
        if set(message.updates) <= {"value"}:
            await handle(client, message)

    gui._websock_interface.unregister_handler(GuiUpdateMessage, handle)
    gui._websock_interface.register_handler(GuiUpdateMessage, handle_values)


def camera_position(client: viser.ClientHandle) -> tuple[float, float, float] | None:
    """Return the position of a browser's camera [m], or None while it is unknown."""
    try:
        x, y, z = client.camera.position.tolist()
    except AssertionError:  # viser's way of saying that the camera has not been received yet
        return None
    return x, y, z


def element_id(handle: viser.GuiInputHandle[float] | viser.GuiButtonHandle) -> str:
    """Return the id of a control's element in the page."""
    return str(handle._impl.uuid)


def script_html(script: str) -> str:
    """Return HTML that runs JavaScript when viser puts it into a page.

    A browser does not run script elements of HTML that is inserted later, but it does run the
    error handler of an image.
    """
    quoted = script.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return f'<img src="data:," alt="" style="display:none" onerror="{quoted}">'


def style_html(*rules: str) -> str:
    """Return HTML that adds CSS rules to the page."""
    return f"<style>{''.join(rules)}</style>"


def selector(handles: Iterable[viser.GuiButtonHandle], suffix: str = "") -> str:
    """Return the CSS selector of some buttons, each followed by a suffix."""
    return ",".join(f'[id="{element_id(handle)}"]{suffix}' for handle in handles)


def _wrappers(buttons: Iterable[viser.GuiButtonHandle]) -> str:
    return ",".join(f'div:has(>[id="{element_id(button)}"])' for button in buttons)


def row_css(buttons: Iterable[viser.GuiButtonHandle], columns: int = 3) -> str:
    """Return CSS that places buttons next to each other; viser would stack them."""
    buttons = list(buttons)
    return (
        f"{_wrappers(buttons)}{{display:inline-block!important;vertical-align:top;"
        f"width:calc({100.0 / columns:.3f}% - 0.5em);margin-inline:0.25em!important}}"
        f"{selector(buttons)}{{padding:0 0.2em;font-size:0.8em}}"
    )


def hidden_css(buttons: Iterable[viser.GuiButtonHandle]) -> str:
    """Return CSS that hides buttons, which still can be pressed by a script."""
    return f"{_wrappers(buttons)}{{display:none!important}}"


def badge_css(button: viser.GuiButtonHandle, text: str) -> str:
    """Return CSS that displays a text in the corner of a button.

    The second, empty text is for screen readers: the name of the button is its label alone.
    """
    return (
        f'[id="{element_id(button)}"]::after{{content:"{text}";content:"{text}"/"";'
        "position:absolute;right:3px;top:2px;font-size:0.75em;line-height:1;opacity:0.8}"
    )


def panel_height_css(button: viser.GuiButtonHandle, height: int) -> str:
    """Return CSS that fixes the height [px] of the panel with a button."""
    return f"{_panel(button)}{{flex:0 0 {height}px!important}}"


def last_panel_css(above: viser.GuiButtonHandle) -> str:
    """Return CSS that gives the last panel the rest of the height, below the panel of a button.

    viser would give it a fraction of the height that its neighbour had.
    """
    return f"{_panel(above)}~div:last-child{{flex:1 1 0!important}}"


def marked_panel_html(name: str, height: int) -> str:
    """Return HTML that fixes the height [px] of its panel and leaves the rest to the one above.

    viser would share the height evenly between the two.
    """
    return (
        f'<style class="{name}">[data-dock-scroll]>div:has(.{name}){{flex:0 0 '
        f"{height}px!important}}"
        f"[data-dock-scroll]>div:first-child:has(~div .{name})"
        "{flex:1 1 0!important}</style>"
    )


def _panel(button: viser.GuiButtonHandle) -> str:
    return f'[data-dock-scroll]>div:has([id="{element_id(button)}"])'
