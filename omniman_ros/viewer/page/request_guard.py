"""Decision which requests the page's server answers: viser has no authentication of its own.

A browser lets any web page that its user opens connect to a WebSocket on localhost, wherever that
page comes from: such a page could press the buttons. But a browser reports which page sends a
request (`Origin`) and under which name it found the server (`Host`): both are checked before viser
sees the request.

A page that others than this machine can reach has a token in its address, as Jupyter's pages have.
Who shows it is given a cookie, with which the browser's further requests are answered.
"""

import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers

from omniman_ros.viewer.page_access import is_loopback


class RequestGuard:
    """Decides about requests by their address and headers."""

    def __init__(
        self, host: str, port: int, token: str = "", *, is_encrypted: bool = False
    ) -> None:
        self._host, self._token = host, token
        self._cookie = f"omniman_{port}"  # cookies know no ports
        self._is_encrypted = is_encrypted

    def rejection_reason(self, path: str, headers: Headers) -> str:
        """Return why a request is rejected, or an empty string."""
        requested = headers.get("Host", "")
        if is_loopback(self._host) and not is_loopback(urlsplit(f"//{requested}").hostname or ""):
            # The name belongs to somebody else, who made it point here (DNS rebinding).
            return f"this page is served as localhost, not as '{requested[:60]}'"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != requested:
            return f"a page from '{origin[:60]}' must not control this robot"
        if self._token and not (self._is_shown(path) or self._has_cookie(headers)):
            return "this page needs its token: open the address that the viewer has printed"
        return ""

    def cookie(self, path: str) -> str:
        """Return the cookie for a browser that shows the token in its address; else nothing."""
        if not (self._token and self._is_shown(path)):
            return ""
        secure = "; Secure" if self._is_encrypted else ""
        return f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict{secure}"

    def _is_shown(self, path: str) -> bool:
        return any(map(self._is_token, parse_qs(urlsplit(path).query).get("token", ())))

    def _has_cookie(self, headers: Headers) -> bool:
        try:
            found = [SimpleCookie(each).get(self._cookie) for each in headers.get_all("Cookie")]
        except CookieError:
            return False
        return any(morsel is not None and self._is_token(morsel.value) for morsel in found)

    def _is_token(self, text: str) -> bool:
        """Compare a text with the token, in a time that does not depend on where they differ."""
        return hmac.compare_digest(text.encode(errors="replace"), self._token.encode())
