"""Keeps other web pages off the robot: viser has no authentication and hears everybody.

A browser lets any page that its user opens, from wherever it comes, connect to a WebSocket on
localhost: that page could press the buttons. A browser does say which page asks (Origin), and
by which name it has found the server (Host): both are checked before viser hears anything.
"""

import http
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

Handler = Callable[[ServerConnection, Request], Response | None]


def is_loopback(host: str) -> bool:
    """Whether an address or name is this machine alone."""
    if host.lower() == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def refusal(host: str, headers: Headers) -> str:
    """Why a request is refused, or nothing.

    Args:
        host: The address that the server is bound to.
        headers: Of the request.
    """
    asked = headers.get("Host", "")
    if is_loopback(host) and not is_loopback(urlsplit(f"//{asked}").hostname or ""):
        # A name of somebody else's that was made to point here (DNS rebinding).
        return f"this page is served as localhost, not as '{asked[:60]}'"
    origin = headers.get("Origin")
    if origin is not None and urlsplit(origin).netloc != asked:
        return f"a page from '{origin[:60]}' may not steer this robot"
    return ""


def _guarded(
    host: str, handler: Handler, connection: ServerConnection, request: Request
) -> Response | None:
    try:
        reason = refusal(host, request.headers)
    except (ValueError, LookupError) as error:  # no address, or a header that is there twice
        reason = str(error)
    if not reason:
        return handler(connection, request)
    body = f"{reason}\n".encode(errors="replace")
    headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body))})
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)


@contextmanager
def guarding(host: str) -> Iterator[None]:
    """Guard the servers that are started in this context; viser offers no way to hand one in."""
    serve = websockets.asyncio.server.serve

    def guarded_serve(*args: Any, process_request: Handler, **options: Any) -> Any:
        guard = partial(_guarded, host, process_request)
        return serve(*args, process_request=guard, **options)

    websockets.asyncio.server.serve = guarded_serve  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
