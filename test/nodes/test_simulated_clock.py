"""Simulated time of the node that publishes /clock, on given real time."""

import pytest
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from omniman_ros.nodes.clock_follower import PERMITS_TOPIC, permit_message
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_clock import CLOCK_START, REPEAT_PERIOD, SimulatedClock
from test.nodes.harness import World

PERIOD = 0.005
PATIENCE = 5.0


class Rig(World):
    """A simulated clock on real time that the test gives, and a probe that permits its steps."""

    def __init__(self, factor=1.0):
        self.real_time = 100.0
        super().__init__(lambda **options: OmnimanNode("owner", **options))
        self.clock = SimulatedClock(
            self.nodes[0], PERIOD, factor, PATIENCE, lambda: self.real_time
        )
        self._permits = self.publisher(Header, PERMITS_TOPIC, 10)
        self.times = self.listen(Clock, "/clock")

    def pass_real_time(self, seconds, tick=PERIOD):
        """Let real time pass, and the clock step at each tick; return the simulated time."""
        start = self.clock.now
        for _ in range(round(seconds / tick)):
            self.real_time += tick
            for _ in self.clock.steps():
                pass
            self.serve()
        return self.clock.now - start

    def permit(self, until, name="/node"):
        self._permits.publish(permit_message(name, until))
        self._await(
            lambda: self.clock._lockstep._permits.get(name) == pytest.approx(until), "the permit"
        )


@pytest.mark.parametrize("factor", [0.1, 1.0, 4.0])
def test_time_passes_in_proportion_to_real_time(factor):
    with Rig(factor) as rig:
        assert rig.pass_real_time(2.0) == pytest.approx(2.0 * factor, abs=2 * PERIOD)


def test_time_stops_at_the_permit_repeats_itself_and_goes_on_with_the_next():
    with Rig() as rig:
        rig.permit(CLOCK_START + 0.1)
        assert rig.pass_real_time(0.3) == pytest.approx(0.1)
        repeated = 0.2 / REPEAT_PERIOD
        rig._await(lambda: len(rig.times) >= 20 + 0.7 * repeated, "the repeated times")
        assert len(rig.times) <= 20 + repeated
        rig.permit(CLOCK_START + 10.0)
        caught_up = rig.pass_real_time(1.0)
        assert 1.0 <= caught_up <= 1.11, "the pace of before, and a short delay caught up with"


def test_time_goes_on_without_a_node_after_the_patience_and_waits_again_for_its_return():
    with Rig() as rig:
        rig.permit(CLOCK_START + 0.1)
        assert rig.pass_real_time(PATIENCE) == pytest.approx(0.1)
        assert rig.pass_real_time(1.0) > 0.8
        rig.permit(rig.clock.now)
        assert rig.pass_real_time(1.0) == 0.0


def test_time_does_not_wait_for_a_node_that_has_left():
    with Rig() as rig:
        rig.permit(CLOCK_START + 0.1)
        rig._permits.publish(permit_message("/node", None))
        rig._await(lambda: not rig.clock._lockstep._permits, "the departure")
        assert rig.pass_real_time(1.0) == pytest.approx(1.0, abs=2 * PERIOD)


def test_a_clock_that_is_released_waits_for_nobody():
    with Rig() as rig:
        rig.permit(CLOCK_START)
        assert rig.pass_real_time(0.5) == 0.0
        rig.clock.release()
        assert rig.pass_real_time(0.5) > 0.5


def test_a_slow_pace_is_reported_with_the_nodes_that_are_waited_for():
    with Rig() as rig:
        rig.pass_real_time(5.0)
        assert rig.clock.pace_report() == ""
        rig.permit(rig.clock.now + 1.0, "/slow")
        rig.pass_real_time(4.0)
        assert rig.clock.pace_report() == (
            "simulated time passes at 0.25 times real time, waiting for /slow"
        )
        assert rig.clock.pace == pytest.approx(0.25, abs=0.01)
        assert rig.clock.pace_report() == "", "no time has passed since the last report"
        assert rig.clock.pace == pytest.approx(0.25, abs=0.01)


def test_who_holds_time_up_is_named_once_it_stands():
    with Rig() as rig:
        rig.permit(CLOCK_START + 0.1, "/slow")
        rig.permit(CLOCK_START + 9.0, "/fast")
        rig.pass_real_time(0.4)
        assert rig.clock.awaited == []
        rig.pass_real_time(0.4)
        assert rig.clock.awaited == ["/slow"]
        rig.permit(CLOCK_START + 9.0, "/slow")
        rig.pass_real_time(PERIOD)
        assert rig.clock.awaited == []


def test_time_does_not_rush_after_a_long_delay_of_its_own_node():
    with Rig() as rig:
        rig.real_time += 60.0
        assert rig.pass_real_time(1.0) < 1.2
