"""The policy on a failing bus: stops that are sent regardless, and their reasons."""

import can
import pytest

from omniman_ros.can_drives.bus import MAX_TAKEN_FRAMES
from omniman_ros.can_drives.drives import LISTEN_TIME, CanDrivesPhase
from omniman_ros.can_drives.link import CanLink
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.robots import robot_parameters
from test.can_drives.fake_bus import FakeBus, message
from test.can_drives.scripted import COMMAND, PROTOCOL, REPORT, SYNC

NODES = (11, 12, 13, 14)
STOP = b"s"


class Clock:
    """Clock that advances by a millisecond with each reading."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        self.now += 1e-3
        return self.now


@pytest.fixture
def link(monkeypatch):
    fake = FakeBus(True)
    monkeypatch.setattr(can, "Bus", lambda **options: fake)
    robot = build(Platform, robot_parameters("omniman"))
    made = CanLink(robot, CanParameters(nodes=NODES, protocol=PROTOCOL), Clock())
    made.fake = fake
    yield made
    made.close()


def reports(link):
    link.fake.put(*[message(REPORT + node, bytes(8)) for node in NODES])


def up(link):
    link.drives.configure(link._clock())
    link._clock.now += LISTEN_TIME
    for _ in range(3):
        reports(link)
        link.tick()
    assert link.drives.phase is CanDrivesPhase.IDLE
    link.drives.enable(link._clock())
    for _ in range(3):
        reports(link)
        link.tick()
    assert link.drives.phase is CanDrivesPhase.DRIVING
    link.fake.sent.clear()
    return link


def commanded_to_stop(link):
    return {m.arbitration_id - COMMAND for m in link.fake.sent if bytes(m.data[:1]) == STOP}


def test_received_and_sent_frames_are_counted(link):
    up(link)
    received, sent = link.received, link.sent
    reports(link)
    link.tick()
    assert (link.received - received, link.sent - sent) == (4, 5)


def test_frame_that_cannot_be_sent_stops_all_and_the_stop_is_tried(link):
    up(link)
    refused = []

    def refuse(sent):
        if sent.arbitration_id == COMMAND + 12 and not refused:
            refused.append(sent)
            return can.CanOperationError("queue full")
        return None

    link.fake.refusal = refuse
    reports(link)
    link.tick()
    assert link.drives.stop_reason.startswith("bus: frame 20C#")
    assert link.drives.stop_reason.endswith("not sent: queue full")
    assert commanded_to_stop(link) == set(NODES)


def test_stop_is_sent_again_each_period_on_a_bus_that_accepts_nothing(link):
    up(link)
    link.fake.refusal = lambda sent: OSError(105, "No buffer space available")
    link.tick()
    assert "No buffer space" in link.drives.stop_reason
    link.fake.refusal = None
    reports(link)
    link.tick()
    assert commanded_to_stop(link) == set(NODES)
    assert "No buffer space" in link.drives.stop_reason, "and the first reason stays"


@pytest.mark.parametrize(
    ("happen", "reason"),
    [
        (
            lambda fake: fake.put(message(0x040, bytes(8), is_error_frame=True)),
            "bus: off (error frame)",
        ),
        (
            lambda fake: fake.put(OSError(100, "Network is down")),
            "bus: cannot be read: [Errno 100] Network is down",
        ),
        (
            lambda fake: fake.put(message(COMMAND + 13, b"d\x01\x02\x03\x04")),
            "another host commands the drives: frame 20D#6401020304",
        ),
        (lambda fake: setattr(fake, "said", can.BusState.ERROR), "bus: off"),
    ],
)
def test_every_bus_event_stops_all_within_the_period(link, happen, reason):
    up(link)
    reports(link)
    happen(link.fake)
    link.tick()
    assert link.drives.stop_reason == reason
    assert commanded_to_stop(link) == set(NODES)


def test_bus_that_fails_while_the_drives_are_configured_ends_that_with_its_reason(link):
    link.drives.configure(link._clock())
    link.fake.refusal = lambda sent: OSError(105, "No buffer space available")
    assert link.run_until(lambda: link.drives.phase is not CanDrivesPhase.CONFIGURING, 1.0)
    assert link.drives.phase is CanDrivesPhase.UNCONFIGURED
    assert link.drives.stop_reason.startswith("not configured: bus: frame ")
    assert "No buffer space" in link.drives.stop_reason


def test_flood_does_not_keep_the_periods_from_being_done(link):
    up(link)
    link.fake.endless = message(0x7A5)
    link.fake.put(message())
    received = link.received
    link.tick()
    assert link.received - received == MAX_TAKEN_FRAMES
    assert SYNC in {sent.arbitration_id for sent in link.fake.sent}


def test_periods_are_done_until_a_condition_holds(link):
    up(link)
    ticks = []
    tick = link.tick
    link.tick = lambda: (ticks.append(link._clock.now), tick())
    assert link.run_until(lambda: len(ticks) == 5, 10.0)
    assert not link.run_until(lambda: False, 0.1)
    link.fake.put(message(REPORT + 11, bytes(8)))
    assert link.run_until(lambda: True, 0.0)
