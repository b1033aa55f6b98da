"""Own echoes and other hosts."""

import pytest

from omniman_ros.can_drives.foreign_host import ECHO_MEMORY, ForeignHostDetector
from omniman_ros.can_drives.frame import CanFrame

OWN = CanFrame(0x201, b"\x0f\x00")


@pytest.fixture
def host_detector():
    return ForeignHostDetector([(0x201, False), (0x80, False)])


def test_only_ids_of_the_host_are_its_own(host_detector):
    assert host_detector.is_host_frame(OWN)
    assert not host_detector.is_host_frame(CanFrame(0x201, b"", True))
    assert not host_detector.is_host_frame(CanFrame(0x181, b""))


def test_each_frame_comes_back_once_and_in_any_order(host_detector):
    other = OWN._replace(data=b"\x06\x00")
    host_detector.record_sent([OWN, other])
    assert [host_detector.is_echo(frame) for frame in (other, OWN)] == [True, True]
    assert host_detector.counts == {"echo": 2}


def test_equal_frame_once_more_is_from_another_host(host_detector):
    host_detector.record_sent([OWN])
    assert [host_detector.is_echo(OWN), host_detector.is_echo(OWN)] == [True, False]


@pytest.mark.parametrize(
    "frame", [OWN._replace(data=b"\x07"), OWN._replace(remote=True), CanFrame(0x80, b"")]
)
def test_frame_that_was_not_sent_is_no_echo(host_detector, frame):
    host_detector.record_sent([OWN])
    assert not host_detector.is_echo(frame)
    assert not host_detector.counts["echo"]


def test_memory_is_bounded_where_nothing_comes_back(host_detector):
    for k in range(10 * ECHO_MEMORY):
        host_detector.record_sent(
            [CanFrame(0x201, k.to_bytes(4, "little")), CanFrame(0x300 + k, b"")]
        )
    assert {key: len(sent) for key, sent in host_detector._sent.items()} == {
        (0x201, False): ECHO_MEMORY,
        (0x80, False): 0,
    }
    assert not host_detector.is_echo(CanFrame(0x201, (8 * ECHO_MEMORY).to_bytes(4, "little")))
    assert host_detector.is_echo(CanFrame(0x201, (10 * ECHO_MEMORY - 1).to_bytes(4, "little")))
