"""The policy on a bus that fails: what is sent all the same, and what is said."""

import can
import pytest

from omniman_ros.can_drive import protocols
from omniman_ros.can_drive.bus import MOST
from omniman_ros.can_drive.drives import LISTEN
from omniman_ros.can_drive.link import CanLink
from omniman_ros.can_drive.phase import Phase
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.robots import load_robot

from .fake_bus import FakeBus, message
from .scripted import COMMAND, ENTRY, REPORT, SYNC

NODES = (11, 12, 13, 14)
STOP = b"s"


class Clock:
    """Time that passes by a millisecond whenever somebody looks."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        self.now += 1e-3
        return self.now


@pytest.fixture
def link(monkeypatch):
    monkeypatch.setitem(protocols.PROTOCOLS, "vesc", ENTRY)
    fake = FakeBus(True)
    monkeypatch.setattr(can, "Bus", lambda **options: fake)
    robot = build(Robot, load_robot("omniman"))
    made = CanLink(robot, CanParameters(nodes=NODES, protocol="vesc"), Clock())
    made.fake = fake
    yield made
    made.close()


def reports(link):
    link.fake.put(*[message(REPORT + node, bytes(8)) for node in NODES])


def up(link):
    link.drives.configure(link._clock())
    link._clock.now += LISTEN
    for _ in range(3):
        reports(link)
        link.tick()
    assert link.drives.phase is Phase.IDLE
    link.drives.enable(link._clock())
    for _ in range(3):
        reports(link)
        link.tick()
    assert link.drives.phase is Phase.DRIVING
    link.fake.sent.clear()
    return link


def told_to_stop(link):
    return {m.arbitration_id - COMMAND for m in link.fake.sent if bytes(m.data[:1]) == STOP}


def test_what_is_heard_and_sent_is_counted(link):
    up(link)
    heard, sent = link.heard, link.sent
    reports(link)
    link.tick()
    assert (link.heard - heard, link.sent - sent) == (4, 5)


def test_a_frame_that_cannot_be_sent_stops_all_and_the_stop_is_tried(link):
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
    assert told_to_stop(link) == set(NODES)


def test_a_bus_that_takes_nothing_is_told_to_stop_again_each_period(link):
    up(link)
    link.fake.refusal = lambda sent: OSError(105, "No buffer space available")
    link.tick()
    assert "No buffer space" in link.drives.stop_reason
    link.fake.refusal = None
    reports(link)
    link.tick()
    assert told_to_stop(link) == set(NODES)
    assert "No buffer space" in link.drives.stop_reason, "and the first reason stays"


@pytest.mark.parametrize(
    ("happen", "reason"),
    [
        (lambda fake: fake.put(message(0x040, bytes(8), is_error_frame=True)),
         "bus: off (error frame)"),
        (lambda fake: fake.put(OSError(100, "Network is down")),
         "bus: cannot be read: [Errno 100] Network is down"),
        (lambda fake: fake.put(message(COMMAND + 13, b"d\x01\x02\x03\x04")),
         "another host commands the drives: frame 20D#6401020304"),
        (lambda fake: setattr(fake, "said", can.BusState.ERROR), "bus: off"),
    ],
)  # fmt: skip
def test_what_happens_to_the_bus_stops_all_within_the_period(link, happen, reason):
    up(link)
    reports(link)
    happen(link.fake)
    link.tick()
    assert link.drives.stop_reason == reason
    assert told_to_stop(link) == set(NODES)


def test_a_bus_that_fails_while_the_drives_are_configured_ends_that_with_its_reason(link):
    link.drives.configure(link._clock())
    link.fake.refusal = lambda sent: OSError(105, "No buffer space available")
    assert link.run_until(lambda: link.drives.phase is not Phase.CONFIGURING, 1.0)
    assert link.drives.phase is Phase.UNCONFIGURED
    assert link.drives.stop_reason.startswith("not configured: bus: frame ")
    assert "No buffer space" in link.drives.stop_reason


def test_a_flood_does_not_keep_the_periods_from_being_done(link):
    up(link)
    link.fake.endless = message(0x7A5)
    link.fake.put(message())
    heard = link.heard
    link.tick()
    assert link.heard - heard == MOST
    assert SYNC in {sent.arbitration_id for sent in link.fake.sent}


def test_periods_are_done_until_something_is(link):
    up(link)
    ticks = []
    tick = link.tick
    link.tick = lambda: (ticks.append(link._clock.now), tick())
    assert link.run_until(lambda: len(ticks) == 5, 10.0)
    assert not link.run_until(lambda: False, 0.1)
    link.fake.put(message(REPORT + 11, bytes(8)))
    assert link.run_until(lambda: True, 0.0)
