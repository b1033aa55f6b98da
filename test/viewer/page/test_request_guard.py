import pytest
from websockets.datastructures import Headers

from omniman_ros.viewer.page.request_guard import is_loopback, rejection_reason


@pytest.mark.parametrize(
    ("host", "loopback"),
    [
        ("127.0.0.1", True),
        ("localhost", True),
        ("LOCALHOST", True),
        ("::1", True),
        ("127.1.2.3", True),
        ("0.0.0.0", False),
        ("192.168.1.5", False),
        ("robot.local", False),
        ("", False),
        ("localhost.evil.org", False),
    ],
)
def test_loopback_addresses_are_recognised(host, loopback):
    assert is_loopback(host) is loopback


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
