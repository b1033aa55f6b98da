"""Bridge and simulated drives that take turns in simulated time, over a socket."""

import can
import pytest

from omniman_ros.can_drives.bus import BusError
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes import paced_bus
from omniman_ros.nodes.can_bridge import CanBridgeNode
from omniman_ros.nodes.paced_bus import PacedBus
from omniman_ros.nodes.paced_can_link import PARTICIPANT, PacedCanLink
from omniman_ros.nodes.simulated_can_drives import SimulatedCanDrivesNode
from test.nodes.harness import World

STEP = 0.005
BOOTED = 1.3  #: Simulated time at which the drives have booted [s]
REQUEST = CanFrame(0x601, b"\x40\x00\x10\x00\x00\x00\x00\x00")
ANSWER = CanFrame(0x581, b"\x43\x00\x10\x00\x92\x01\x02\x00")


class Drives:
    """The drives' end, with a clock and a node that only remember."""

    def __init__(self) -> None:
        self.time, self.permits, self.warnings = 2.0, {}, []
        self.link = PacedCanLink(self, 0, STEP, self)

    def now(self):
        return self.time

    def get_logger(self):
        return self

    def info(self, text):
        pass

    def warn(self, subject, text):
        self.warnings.append(text)

    def permit(self, name, until):
        self.permits[name] = until

    def leave(self, name):
        self.permits.pop(name, None)

    def step(self, *frames):
        """Make a step of simulated time, and send frames of it."""
        self.time += STEP
        self.link.send([message(frame) for frame in frames], self.time)

    def answer(self):
        """Answer each frame that has arrived; return the frames."""
        heard = self.link.receive()
        if heard:
            self.link.send([message(ANSWER) for _ in heard], self.time)
        return [CanFrame(each.arbitration_id, bytes(each.data)) for each in heard]

    @property
    def may_step(self):
        """Whether the bridge lets time make its next step."""
        self.link.receive()
        return self.permits.get(PARTICIPANT, self.time + STEP) >= self.time + STEP


def message(frame):
    return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)


class Pair:
    """Both ends. Whenever the bridge waits, `serve` is called, as there are no threads."""

    def __init__(self) -> None:
        self.drives = Drives()
        self.time = self.drives.time
        self.heard = []
        self.serve = lambda: self.heard.extend(self.drives.answer())
        self.bus = PacedBus(self.drives.link.port, lambda: self.time, lambda: None)
        wait = self.bus._connection.wait
        self.bus._connection.wait = lambda timeout: (self.serve(), wait(timeout))
        assert list(self.bus.take()) == []

    def close(self):
        self.bus.close()
        self.drives.link.close()


@pytest.fixture
def pair():
    pair = Pair()
    yield pair
    pair.close()


def test_time_makes_a_step_when_the_bridge_is_done_with_the_last_one(pair):
    pair.bus.send(())
    assert pair.drives.may_step
    pair.drives.step(CanFrame(0x701, b"\x05"))
    assert not pair.drives.may_step
    assert list(pair.bus.take()) == [CanFrame(0x701, b"\x05")]
    pair.time += STEP
    assert list(pair.bus.take()) == []
    assert not pair.drives.may_step
    pair.bus.send(())
    assert pair.drives.may_step


def test_the_bridge_is_done_with_no_time_that_it_has_not_come_to(pair):
    """Its clock may be behind the drives' records, and they behind its clock."""
    pair.drives.step()
    pair.drives.step()
    list(pair.bus.take())
    pair.bus.send(())
    assert not pair.drives.may_step  # its own time is two steps behind


def test_an_answer_takes_no_time(pair):
    assert pair.bus.send([REQUEST]) == ""
    assert list(pair.bus.take()) == [ANSWER]
    assert pair.heard == [REQUEST]


def test_frames_of_a_later_time_wait(pair):
    pair.drives.step(CanFrame(0x181, b"\x01"))
    pair.drives.step(CanFrame(0x181, b"\x02"))
    assert [frame.data for frame in pair.bus.take()] == [b"\x01"]
    pair.time += STEP
    assert [frame.data for frame in pair.bus.take()] == [b"\x02"]


def test_drives_that_are_frozen_hold_the_bridge_up_for_a_while_only(pair, monkeypatch):
    monkeypatch.setattr(paced_bus, "DRIVES_TIMEOUT", 0.05)
    pair.serve = lambda: None
    pair.bus.send([REQUEST])
    assert list(pair.bus.take()) == []
    assert pair.bus.failure == ""


def test_drives_that_have_ended_are_a_failure_of_the_bus(pair):
    pair.drives.link.close()
    (failure,) = pair.bus.take()
    assert failure.startswith("lost: ") and pair.bus.failure == failure
    assert pair.bus.send([REQUEST]) == failure
    assert list(pair.bus.take()) == []


def test_time_does_not_wait_for_a_bridge_that_has_ended(pair):
    pair.bus.send(())
    pair.drives.step()
    assert not pair.drives.may_step
    pair.bus.close()
    assert pair.drives.may_step
    assert "disconnected" in pair.drives.warnings[-1]


def test_garbage_ends_the_connection(pair):
    pair.bus._connection.send(b"x" * 40)
    assert pair.drives.link.receive() == []
    assert "no record" in pair.drives.warnings[-1]


def test_a_second_host_is_refused(pair):
    second = PacedBus(pair.drives.link.port, lambda: 0.0, lambda: None)
    pair.drives.link.receive()
    assert any("lost" in str(item) for item in second.take())
    assert "second host" in pair.drives.warnings[-1]


def test_a_bus_without_drives_cannot_be_opened():
    drives = Drives()
    port = drives.link.port
    drives.link.close()
    with pytest.raises(BusError, match="no simulated drives"):
        PacedBus(port, lambda: 0.0, lambda: None)


@pytest.mark.parametrize(("simulated", "port"), [(True, 0), (False, 40000)])
def test_the_bridge_needs_the_time_of_its_drives(simulated, port):
    parameters = {
        "can.nodes": [1, 2, 3, 4],
        "use_sim_time": simulated,
        "simulated_bus_port": port,
    }
    with (
        pytest.raises(ParameterError, match="use_sim_time"),
        World(CanBridgeNode, parameters=parameters),
    ):
        pass


def test_bridge_and_drives_come_up_and_time_passes_only_with_both():
    """The drives give time as fast as they can; the test plays /clock."""
    given = {"can.nodes": [1, 2, 3, 4]}
    drives = {"use_sim_time": False, "publish_clock": True, "real_time_factor": 100.0}
    with World(SimulatedCanDrivesNode, parameters=given | drives) as world:
        node = world.nodes[0]
        clock, link = node.simulated_clock, node._link
        while clock.now < BOOTED:
            node.tick()
        bus = PacedBus(link.port, lambda: clock.now, lambda: None)
        node.tick()
        before = clock.now
        list(bus.take())
        bus.send(())
        for _ in range(50):
            node.tick()
        assert clock.now == pytest.approx(before + STEP)
        bus.send([REQUEST])
        node.tick()
        assert list(bus.take()) == [ANSWER]
        bus.send(())
        for _ in range(50):
            node.tick()
        assert clock.now == pytest.approx(before + 2 * STEP)
        assert PARTICIPANT in clock.laggards
        bus.close()
