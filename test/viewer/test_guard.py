import pytest
from websockets.datastructures import Headers

from omniman_ros.viewer.guard import is_loopback, refusal


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("localhost", True), ("LOCALHOST", True), ("::1", True),
     ("127.1.2.3", True), ("0.0.0.0", False), ("192.168.1.5", False), ("robot.local", False),
     ("", False), ("localhost.evil.org", False)],
)  # fmt: skip
def test_what_is_this_machine_alone(host, loopback):
    assert is_loopback(host) is loopback


@pytest.mark.parametrize(
    "headers",
    [{"Host": "127.0.0.1:8080"}, {"Host": "localhost:8080"}, {"Host": "[::1]:8080"},
     {"Host": "localhost:8080", "Origin": "http://localhost:8080"}],
)  # fmt: skip
def test_a_page_of_ones_own_is_served(headers):
    assert refusal("127.0.0.1", Headers(headers)) == ""


@pytest.mark.parametrize(
    ("headers", "word"),
    [({"Host": "localhost:8080", "Origin": "http://evil.org"}, "evil.org"),
     ({"Host": "localhost:8080", "Origin": "http://localhost:9090"}, "9090"),
     ({"Host": "localhost:8080", "Origin": "null"}, "null"),
     ({"Host": "rebound.evil.org:8080", "Origin": "http://rebound.evil.org:8080"}, "rebound"),
     ({"Host": "rebound.evil.org:8080"}, "rebound"),
     ({}, "localhost")],
)  # fmt: skip
def test_a_page_of_somebody_elses_is_not(headers, word):
    assert word in refusal("127.0.0.1", Headers(headers))


def test_a_server_for_others_goes_by_any_name_but_still_refuses_other_pages():
    own = {"Host": "robot.local:8080", "Origin": "http://robot.local:8080"}
    assert refusal("0.0.0.0", Headers(own)) == ""
    assert refusal("0.0.0.0", Headers(own | {"Origin": "http://evil.org"})) != ""
