import pytest
from websockets.datastructures import Headers

from omniman_ros.viewer.page.request_guard import RequestGuard


def rejection_reason(host, headers, path="/", token=""):
    """Return why a server on a host rejects a request."""
    return RequestGuard(host, 8080, token).rejection_reason(path, headers)


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "127.0.0.1:8080"},
        {"Host": "localhost:8080"},
        {"Host": "[::1]:8080"},
        {"Host": "localhost:8080", "Origin": "http://localhost:8080"},
    ],
)
def test_requests_of_the_own_page_are_accepted(headers):
    assert rejection_reason("127.0.0.1", Headers(headers)) == ""


@pytest.mark.parametrize(
    ("headers", "word"),
    [
        ({"Host": "localhost:8080", "Origin": "http://evil.org"}, "evil.org"),
        ({"Host": "localhost:8080", "Origin": "http://localhost:9090"}, "9090"),
        ({"Host": "localhost:8080", "Origin": "null"}, "null"),
        ({"Host": "rebound.evil.org:8080", "Origin": "http://rebound.evil.org:8080"}, "rebound"),
        ({"Host": "rebound.evil.org:8080"}, "rebound"),
        ({}, "localhost"),
    ],
)
def test_requests_of_foreign_pages_are_rejected(headers, word):
    assert word in rejection_reason("127.0.0.1", Headers(headers))


def test_a_server_for_others_goes_by_any_name_but_still_refuses_other_pages():
    own = {"Host": "robot.local:8080", "Origin": "http://robot.local:8080"}
    assert rejection_reason("0.0.0.0", Headers(own)) == ""
    assert rejection_reason("0.0.0.0", Headers(own | {"Origin": "http://evil.org"})) != ""


TOKEN = "a-token_of-16-ch"
OWN = {"Host": "robot.local:8080"}


@pytest.mark.parametrize(
    "path", [f"/?token={TOKEN}", f"/?a=b&token={TOKEN}", f"/x/y?token={TOKEN}"]
)
def test_the_token_is_found_in_the_address(path):
    assert rejection_reason("0.0.0.0", Headers(OWN), path, TOKEN) == ""
    assert RequestGuard("0.0.0.0", 8080, TOKEN).cookie(path).startswith(f"omniman_8080={TOKEN};")


@pytest.mark.parametrize(
    "path", ["/", "/?token=", f"/?token={TOKEN}x", f"/{TOKEN}", "/?token=%ff%00", "/?token=ä"]
)
def test_anything_else_is_not_the_token(path):
    assert "token" in rejection_reason("0.0.0.0", Headers(OWN), path, TOKEN)
    assert RequestGuard("0.0.0.0", 8080, TOKEN).cookie(path) == ""


@pytest.mark.parametrize(
    ("cookie", "opens"),
    [
        (f"omniman_8080={TOKEN}", True),
        (f"other=1; omniman_8080={TOKEN}", True),
        (f"omniman_8081={TOKEN}", False),
        ("omniman_8080=", False),
        ("omniman_8080", False),
        (";;=,;", False),
    ],
)
def test_the_cookie_of_this_port_opens_the_page(cookie, opens):
    headers = Headers({**OWN, "Cookie": cookie})
    assert (rejection_reason("0.0.0.0", headers, "/", TOKEN) == "") is opens


def test_a_token_does_not_open_the_page_to_other_pages():
    headers = Headers({**OWN, "Origin": "http://evil.org", "Cookie": f"omniman_8080={TOKEN}"})
    assert "evil.org" in rejection_reason("0.0.0.0", headers, f"/?token={TOKEN}", TOKEN)


def test_a_page_without_a_token_sets_no_cookie():
    assert RequestGuard("127.0.0.1", 8080).cookie("/?token=") == ""


def test_the_cookie_of_an_encrypted_page_is_sent_encrypted_only():
    guard = RequestGuard("0.0.0.0", 8080, TOKEN, is_encrypted=True)
    assert guard.cookie(f"/?token={TOKEN}").endswith("; Secure")
