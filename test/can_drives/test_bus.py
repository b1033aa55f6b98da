"""The bus: handling of errors and messages from python-can."""

import threading
import time

import can
import pytest

from omniman_ros.can_drives import bus as bus_module
from omniman_ros.can_drives.bus import MAX_TAKEN_FRAMES, BusError, CanBus
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.core.can_parameters import CanParameters
from test.can_drives.fake_bus import FakeBus, caused, message

PATIENCE = 5.0


@pytest.fixture(params=[True, False], ids=["descriptor", "thread"])
def bus(request, monkeypatch):
    """Return a bus on a fake of python-can; `heard` is set when its thread wakes the reader."""
    fake = FakeBus(request.param)
    monkeypatch.setattr(can, "Bus", lambda **options: fake)
    heard = threading.Event()
    made = CanBus(CanParameters(nodes=(1, 2, 3, 4)), heard.set)
    made.fake, made.heard_of = fake, heard
    yield made
    made.close()


def take(bus, count):
    """Return the next items, up to a given number."""
    items, end = [], time.monotonic() + PATIENCE
    while len(items) < count:
        assert time.monotonic() < end, f"heard only {items}"
        bus.wait(0.1)
        items += bus.take()
    return items


def open_bus(monkeypatch, make):
    monkeypatch.setattr(can, "Bus", make)
    return CanBus(CanParameters(nodes=(1,)))


def raiser(error):
    def make(**options):
        raise error

    return make


@pytest.mark.parametrize(
    "error",
    [
        OSError(19, "No such device"),
        can.CanInitializationError("no such device"),
        can.CanInterfaceNotImplementedError("no such interface"),
        ValueError("no such channel"),
        ImportError("no such module"),
        KeyError("no such key"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_bus_that_cannot_be_opened_is_reported_with_the_reason(monkeypatch, error):
    with pytest.raises(BusError, match=r"bus socketcan can0 cannot be opened: .*no such|No such"):
        open_bus(monkeypatch, raiser(error))


def test_error_without_text_is_reported_by_its_type(monkeypatch):
    with pytest.raises(BusError, match="bus socketcan can0 cannot be opened: TimeoutError"):
        open_bus(monkeypatch, raiser(TimeoutError()))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (
            {"interface": "udp_multicast", "channel": "239.74.163.2", "port": 5},
            {"port": 5, "hop_limit": 0, "fd": False},
        ),
        ({"interface": "virtual", "channel": "x"}, {}),
        (
            {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 500_000},
            {"bitrate": 500_000},
        ),
    ],
)
def test_each_interface_gets_its_own_options(monkeypatch, given, expected):
    asked, enlarged = {}, []

    def make(**options):
        asked.update(options)
        return FakeBus(False)

    monkeypatch.setattr(can, "Bus", make)
    monkeypatch.setattr(bus_module, "enlarge_receive_buffer", enlarged.append)
    CanBus(CanParameters(nodes=(1,), **given)).close()
    assert len(enlarged) == (given["interface"] == "udp_multicast")
    assert asked == {key: given[key] for key in ("interface", "channel")} | expected


def test_frames_are_returned_as_received_and_the_receiver_is_woken(bus):
    bus.fake.put(
        message(0x181, b"abc"),
        message(0x1B02, b"12345678", is_extended_id=True),
        message(0x701, b"", is_remote_frame=True),
    )
    assert bus.heard_of.wait(PATIENCE)
    assert take(bus, 3) == [
        CanFrame(0x181, b"abc"),
        CanFrame(0x1B02, b"12345678", True),
        CanFrame(0x701, b"", False, True),
    ]
    assert list(bus.take()) == []


@pytest.mark.parametrize(
    "nonsense",
    [
        caused(can.CanOperationError("could not unpack"), TypeError("no frame")),
        ValueError("not hexadecimal"),
        message(0x181, bytes(12), is_fd=True, dlc=12),
    ],
    ids=["udp", "slcan", "fd"],
)
def test_an_invalid_frame_is_counted_and_the_following_frame_is_received(bus, nonsense):
    bus.fake.put(nonsense, message(0x182))
    assert take(bus, 1) == [CanFrame(0x182, b"abc")]
    assert bus.invalid == 1


@pytest.mark.parametrize(
    "error",
    [
        caused(can.CanOperationError("network is down"), OSError(100, "down")),
        can.CanOperationError("the bus is off"),
        OSError(19, "no such device"),
        can.CanTimeoutError("no answer"),
    ],
    ids=["socketcan", "pcan", "bare", "timeout"],
)
def test_read_failure_is_reported_and_reading_continues(bus, error):
    bus.fake.put(error)
    (said,) = take(bus, 1)
    assert said == f"cannot be read: {error}"
    assert not bus.invalid
    bus.fake.put(message())
    assert take(bus, 1) == [CanFrame(0x181, b"abc")]


def test_permanently_broken_bus_does_not_wake_the_reader_continuously(bus):
    bus.fake.endless = OSError(19, "no such device")
    bus.fake.put(message())  # so that a descriptor is ready
    woken = []
    bus._wake = lambda: woken.append(list(bus.take()))
    for _ in range(4):
        bus._closing.wait(0.05)
    assert woken
    assert len(woken) <= 4


def test_error_frames_are_not_data_and_only_bus_off_is_a_failure(bus):
    # linux/can/error.h: CAN_ERR_CRTL 0x004, CAN_ERR_BUSOFF 0x040, CAN_ERR_RESTARTED 0x100
    for flag in (0x004, 0x100, 0x040):
        bus.fake.put(message(flag, bytes(8), is_error_frame=True))
    bus.fake.put(message())
    assert take(bus, 2) == ["off (error frame)", CanFrame(0x181, b"abc")]


def test_message_fields_become_plain_values(bus):
    strange = message(0x201)
    strange.arbitration_id, strange.is_extended_id, strange.is_remote_frame = 513.0, [], "x"
    bus.fake.put(strange)
    (frame,) = take(bus, 1)
    assert str(frame) == "201#R"
    assert [type(value) for value in frame] == [int, bytes, bool, bool]


def test_flood_of_frames_is_received_in_portions(bus):
    bus.fake.put(*[message()] * (2 * MAX_TAKEN_FRAMES + 5))
    bus.wait(PATIENCE)
    while len(bus._received) < 2 * MAX_TAKEN_FRAMES and bus._socket < 0:
        bus._closing.wait(0.01)
    assert len(list(bus.take())) == MAX_TAKEN_FRAMES
    assert len(take(bus, MAX_TAKEN_FRAMES + 5)) == MAX_TAKEN_FRAMES + 5


def test_remaining_frames_are_sent_after_a_send_failure(bus):
    full = can.CanOperationError("No buffer space available")
    bus.fake.refusal = lambda sent: full if sent.arbitration_id == 2 else None
    said = bus.send([CanFrame(1, b""), CanFrame(2, b"\x01"), CanFrame(3, b"", True)])
    assert said == "frame 002#01 not sent: No buffer space available"
    assert [(sent.arbitration_id, sent.is_extended_id) for sent in bus.fake.sent] == [
        (1, False),
        (3, True),
    ]
    bus.fake.refusal = None
    assert bus.send([CanFrame(2, b"", False, True)]) == ""
    assert bus.fake.sent[-1].is_remote_frame


@pytest.mark.parametrize(
    ("said", "failure"),
    [
        (can.BusState.ACTIVE, ""),
        (can.BusState.PASSIVE, ""),
        (can.BusState.ERROR, "off"),
        (NotImplementedError(), ""),
        (can.CanOperationError("gone"), "does not report its state: gone"),
    ],
)
def test_state_that_an_interface_reports_is_used(bus, said, failure):
    bus.fake.said = said
    assert bus.failure == failure


def test_closing_ends_the_thread_and_the_bus(bus):
    bus.fake.put(message())
    assert bus.heard_of.wait(PATIENCE)
    bus.close()
    assert bus.fake.closed
    assert not bus._thread.is_alive()
    bus.fake._pipe = None  # closed


def test_closed_bus_neither_reads_nor_writes_and_may_be_closed_again(bus):
    bus.fake.put(message(0x182))
    bus.close()
    assert list(bus.take()) == []
    assert bus.send([CanFrame(0x201, b"abc")]) == bus.failure == "closed"
    assert bus.fake.sent == []
    bus.close()
