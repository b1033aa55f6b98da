import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.viewer.page_access import PageAccess, is_loopback


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
    ("options", "expected"),
    [
        ({}, False),
        ({"host": "::1"}, False),
        ({"host": "0.0.0.0"}, True),
        ({"host": "robot.local"}, True),
        ({"token": "chosen-token"}, True),
    ],
)
def test_a_page_that_others_can_reach_needs_a_token(options, expected):
    assert PageAccess(**options).needs_token is expected


@pytest.mark.parametrize("token", ["short", "with a blank", "slash/slash", "x" * 300])
def test_a_token_that_is_no_part_of_an_address_is_refused_and_not_shown(token):
    with pytest.raises(ParameterError, match="token") as refused:
        build(PageAccess, {"token": token})
    assert token not in str(refused.value)


@pytest.mark.parametrize("given", ["tls_certificate", "tls_key"])
def test_certificate_and_key_go_together(given):
    with pytest.raises(ParameterError, match="go together"):
        PageAccess(**{given: "file.pem"})


def test_without_files_nothing_is_encrypted():
    assert PageAccess().tls() is None
