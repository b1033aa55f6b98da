"""Own echoes and other hosts."""

import pytest

from omniman_ros.can_drive.frame import Frame
from omniman_ros.can_drive.lookout import MEMORY, Lookout

OWN = Frame(0x201, b"\x0f\x00")


@pytest.fixture
def lookout():
    return Lookout([(0x201, False), (0x80, False)])


def test_only_ids_of_the_host_are_its_own(lookout):
    assert lookout.is_host(OWN)
    assert not lookout.is_host(Frame(0x201, b"", True))
    assert not lookout.is_host(Frame(0x181, b""))


def test_each_frame_comes_back_once_and_in_any_order(lookout):
    other = OWN._replace(data=b"\x06\x00")
    lookout.note([OWN, other])
    assert [lookout.is_echo(frame) for frame in (other, OWN)] == [True, True]
    assert lookout.counts == {"echo": 2}


def test_the_same_words_once_more_are_those_of_another_host(lookout):
    lookout.note([OWN])
    assert [lookout.is_echo(OWN), lookout.is_echo(OWN)] == [True, False]


@pytest.mark.parametrize(
    "frame", [OWN._replace(data=b"\x07"), OWN._replace(remote=True), Frame(0x80, b"")]
)
def test_what_was_not_sent_is_no_echo(lookout, frame):
    lookout.note([OWN])
    assert not lookout.is_echo(frame)
    assert not lookout.counts["echo"]


def test_the_memory_is_bounded_where_nothing_comes_back(lookout):
    for k in range(10 * MEMORY):
        lookout.note([Frame(0x201, k.to_bytes(4, "little")), Frame(0x300 + k, b"")])
    assert {key: len(sent) for key, sent in lookout._sent.items()} == {
        (0x201, False): MEMORY, (0x80, False): 0,
    }  # fmt: skip
    assert not lookout.is_echo(Frame(0x201, (8 * MEMORY).to_bytes(4, "little")))
    assert lookout.is_echo(Frame(0x201, (10 * MEMORY - 1).to_bytes(4, "little")))
