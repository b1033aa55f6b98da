"""Decision which requests the page's server answers: viser has no authentication of its own.

A browser lets any web page that its user opens connect to a WebSocket on localhost, wherever that
page comes from: such a page could press the buttons. But a browser reports which page sends a
request (`Origin`) and under which name it found the server (`Host`): both are checked before viser
sees the request.
"""

from ipaddress import ip_address
from urllib.parse import urlsplit

from websockets.datastructures import Headers


def is_loopback(host: str) -> bool:
    """Return whether an address or a name can only be reached from this machine."""
    if host.lower() == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def rejection_reason(host: str, headers: Headers) -> str:
    """Return why a request is rejected, or an empty string.

    Args:
        host: Address that the server is bound to.
        headers: Headers of the request.
    """
    requested = headers.get("Host", "")
    if is_loopback(host) and not is_loopback(urlsplit(f"//{requested}").hostname or ""):
        # The name belongs to somebody else, who made it point here (DNS rebinding).
        return f"this page is served as localhost, not as '{requested[:60]}'"
    origin = headers.get("Origin")
    if origin is not None and urlsplit(origin).netloc != requested:
        return f"a page from '{origin[:60]}' must not control this robot"
    return ""
