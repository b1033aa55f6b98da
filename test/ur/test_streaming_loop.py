"""The cycle of the streaming process with a simulated node, link and clock."""

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.ur.feedback import ArmSample
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.process_channel import ProcessChannelError
from omniman_ros.ur.program_link import ProgramState
from omniman_ros.ur.streaming_loop import (
    NODE_TIMEOUT,
    REPORT_PERIOD,
    TIMING_COUNT,
    GivenClock,
    StreamingLoop,
)
from omniman_ros.ur.streaming_messages import CommandMessage, StreamingCommand, StreamingPhase
from test.ur.test_streaming_supervisor import HOME, PlayedLink

T0 = 200.0


class PlayedChannel:
    """A channel to a node: the test sets its messages and reads the received ones."""

    def __init__(self):
        self.orders, self.reports = [], []
        self.gone = False

    def fileno(self):
        return 42

    def send(self, report):
        if self.gone:
            raise ProcessChannelError("gone")
        self.reports.append(report)

    def receive(self):
        if self.gone:
            raise ProcessChannelError("gone")
        orders, self.orders = self.orders, []
        return orders


class TimedLink(PlayedLink):
    """A controller that sends a sample each cycle; only waiting advances the time."""

    def __init__(self, channel):
        super().__init__()
        self.channel = channel
        self.now = T0
        self.late = 0.0
        self.ticks, self.waited = [], []
        self.counts, self.refused_connections = {"skipped": 3}, {"second": 1}
        self.position = np.array(HOME)
        self.playing = False
        self.fresh = []
        self.said = ["hello"]
        self.closed = False

    def clock(self):
        return self.now

    def wait(self, until, others):
        self.waited.append(others)
        if others and (self.channel.orders or self.channel.gone):
            return others
        self.now = max(self.now, until) + self.late
        self.late = 0.0
        served = [m for m in self.sent if m[7] == 1]
        if served:
            self.position = np.array(served[-1][1:7]) * 1e-6
        self.sample = ArmSample(
            self.now,
            self.now,
            tuple(self.position),
            (0.0,) * 6,
            tuple(self.position),
            (0.0,) * 6,
            7,
            1,
            2 if self.playing else 1,
            1.0,
            len(served),
        )
        self.fresh.append(self.sample)
        return []

    def start_program(self, text, now):
        super().start_program(text, now)
        self.program, self.playing = ProgramState.RUNNING, True

    def end_program(self):
        super().end_program()
        self.playing = False

    def take_samples(self):
        samples, self.fresh = self.fresh, []
        return samples

    def take_texts(self):
        texts, self.said = self.said, []
        return texts

    def tick(self, now):
        self.ticks.append(now)

    def close(self):
        self.closed = True


class Rig:
    def __init__(self):
        self.channel = PlayedChannel()
        self.link = TimedLink(self.channel)
        self.loop = StreamingLoop(
            self.channel, self.link, ArmParameters(), UrParameters(), self.link.clock
        )
        self.loop.cycle()

    def send(self, command, *arguments):
        self.channel.orders.append(CommandMessage(command, arguments))

    def cycle(self, count=1, lives=True):
        for _ in range(count):
            if lives:
                self.send(StreamingCommand.KEEP_ALIVE)
            self.loop.cycle()

    def preview(self, seconds=4.0, speed=0.3):
        """Return a preview that accelerates and then continues at constant speed."""
        times = np.linspace(0.0, seconds, 200)
        gathered = np.minimum(times, 0.5)
        way = speed * (gathered**2 + np.maximum(times - 0.5, 0.0))
        rate = speed * np.minimum(2.0 * times, 1.0)
        whole = np.ones((1, 6))
        self.send(
            StreamingCommand.PREVIEW,
            self.link.now + times,
            self.link.position + way[:, None] * whole,
            rate[:, None] * whole,
            None,
        )

    @property
    def report(self):
        return self.channel.reports[-1]

    @property
    def speeds(self):
        places = np.array([m[1:7] for m in self.link.sent if m[7] == 1]) * 1e-6
        return np.abs(np.diff(places, axis=0)).max(axis=1) / PERIOD


@pytest.fixture
def rig():
    made = Rig()
    made.send(StreamingCommand.START)
    made.cycle(3)
    assert made.report.phase is StreamingPhase.STREAMING
    return made


def moving(rig):
    rig.preview()
    rig.cycle(100)
    assert rig.speeds[-1] == pytest.approx(0.3, rel=0.01)
    return rig


def test_deadlines_are_absolute(rig):
    before, due = len(rig.link.sent), rig.loop._due
    rig.link.late = 0.003
    rig.cycle()
    rig.cycle(9)
    assert rig.loop._due == pytest.approx(due + 10 * PERIOD)
    assert rig.link.now == pytest.approx(rig.loop._due)
    assert len(rig.link.sent) - before == 10


def test_missed_cycles_are_caught_up_at_once(rig):
    before = len(rig.link.sent)
    rig.link.late = 0.03
    rig.cycle()
    rig.cycle(3)
    assert len(rig.link.sent) - before == 4
    assert rig.report.phase is StreamingPhase.STREAMING


def test_long_delay_latches_a_stop(rig):
    moving(rig)
    rig.link.late = 1.0
    rig.cycle()
    rig.cycle()
    assert rig.report.stop_reason.startswith("a setpoint was delayed by 1.0")
    assert rig.report.phase is StreamingPhase.IDLE


def test_sleep_of_the_machine_is_not_caught_up(rig):
    rig.link.late = 3600.0
    rig.cycle()
    rig.cycle(2)
    assert rig.link.now - rig.loop._due < 2 * PERIOD


def test_only_changes_are_reported(rig):
    first = rig.channel.reports[0]
    assert first.texts == ("hello",)
    assert first.counts == (("skipped", 3), ("second", 1))
    count = len(rig.channel.reports)
    rig.cycle(5)
    assert len(rig.channel.reports) == count + 5, "each sample is reported at once"
    assert all(len(report.samples) == 1 for report in rig.channel.reports[count:])
    rig.link.take_samples = lambda: []
    rig.cycle(round(1.0 / PERIOD))
    silent = len(rig.channel.reports) - count - 5
    assert silent <= 1.0 / REPORT_PERIOD + 1
    assert silent >= 0.5 / REPORT_PERIOD


def test_refusal_is_reported_once(rig):
    rig.preview()
    rig.channel.orders[-1].arguments[1][:] += 1.0
    rig.cycle(3)
    refusals = [why for report in rig.channel.reports for why in report.refusals]
    assert len(refusals) == 1 and "away from the setpoint" in refusals[0]


def test_punctuality_is_reported_in_blocks(rig):
    rig.cycle(2 * TIMING_COUNT + 2)
    told = [report.timing for report in rig.channel.reports if report.timing]
    assert [len(timing.intervals) for timing in told] == [TIMING_COUNT, TIMING_COUNT]
    assert np.allclose([timing.intervals for timing in told], PERIOD)
    assert told[1].ages


def test_report_identifies_the_reset_before(rig):
    rig.send(StreamingCommand.STOP, "by hand")
    rig.cycle(3)
    assert (rig.report.stop_reason, rig.report.resets) == ("by hand", 0)
    rig.send(StreamingCommand.RESET, 7)
    rig.cycle(3)
    assert (rig.report.stop_reason, rig.report.resets) == ("", 7)


def test_parameters_apply_at_runtime(rig):
    moving(rig)
    rig.send(StreamingCommand.CONFIGURE, ArmParameters(velocity=(0.1,)), UrParameters())
    rig.cycle(2)
    assert "velocity" in rig.report.stop_reason


def test_silent_node_causes_the_arm_to_come_to_rest(rig):
    moving(rig)
    since = rig.link.now
    while rig.speeds[-1] > 0.0:
        rig.cycle(lives=False)
        assert rig.link.now - since < NODE_TIMEOUT + 0.15, "4 s of preview are left"
    assert rig.report.phase is StreamingPhase.STREAMING
    refusals = [why for report in rig.channel.reports for why in report.refusals]
    assert refusals == ["the arm is brought to rest: the node sent nothing for 0.5 s"]
    rig.cycle(50)
    assert rig.speeds[-1] == 0.0, "a sign of life alone starts no motion"
    rig.preview()
    rig.cycle(100)
    assert rig.speeds[-1] > 0.2


def test_preview_of_a_live_node_is_followed_to_its_end(rig):
    moving(rig)
    rig.cycle(round(2.0 * NODE_TIMEOUT / PERIOD))
    assert rig.speeds[-1] == pytest.approx(0.3, rel=0.01)


def test_process_without_its_node_brings_the_arm_to_rest_and_ends(rig):
    moving(rig)
    rig.channel.gone = True
    begin = rig.link.now
    rig.loop.run()
    assert rig.link.now - begin < 0.2
    assert rig.link.sent[-1][7] == -2
    assert rig.speeds[-1] == 0.0
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001
    assert rig.link.closed
    assert rig.link.waited[-1] == [], "a closed descriptor would wake the loop continuously"


def test_shutdown_that_takes_too_long_still_ends(rig):
    moving(rig)
    rig.send(StreamingCommand.CONFIGURE, ArmParameters(acceleration=(0.011,)), UrParameters())
    rig.cycle()
    rig.channel.gone = True
    begin = rig.link.now
    rig.loop.run()
    assert rig.link.now - begin < 4.0
    assert rig.link.closed


class SimulatedRig(Rig):
    """A loop whose time is given by its node, and a link that waits for that."""

    def __init__(self):
        self.channel = PlayedChannel()
        self.link = TimedLink(self.channel)
        self.clock = GivenClock(self.link.now)
        self.link.wait = self._wait
        self.loop = StreamingLoop(
            self.channel, self.link, ArmParameters(), UrParameters(), self.clock
        )

    def _wait(self, until, others):
        if self.channel.orders:
            return others
        assert self.clock() >= until, "the loop runs ahead of the time that it was given"
        return []

    def pass_time(self, now):
        self.send(StreamingCommand.TIME, now)
        self.loop.cycle()


def test_on_simulated_time_a_cycle_runs_when_its_time_was_given():
    rig = SimulatedRig()
    start = rig.link.now
    for k in range(1, 6):
        rig.pass_time(start + k * PERIOD)
        assert len(rig.link.ticks) == k
        assert rig.report.sent_until == pytest.approx(start + (k + 1) * PERIOD)
    with pytest.raises(AssertionError, match="runs ahead"):
        rig.loop.cycle()


def test_on_simulated_time_each_cycle_is_reported_although_nothing_else_is_new():
    """Simulated time waits for the report."""
    rig = SimulatedRig()
    rig.link.take_samples = lambda: []
    start, count = rig.link.now, len(rig.channel.reports)
    for k in range(1, 6):
        rig.pass_time(start + k * PERIOD)
    assert len(rig.channel.reports) - count >= 5


def test_simulated_time_that_goes_back_ends_the_process_with_the_reason():
    rig = SimulatedRig()
    start = rig.link.now
    rig.pass_time(start + PERIOD)
    rig.pass_time(1.0)
    assert str(rig.report) == "simulated time has begun anew"
    rig.loop.run()
    assert rig.link.closed


def test_process_whose_node_has_ended_ends_although_simulated_time_stands():
    rig = SimulatedRig()
    rig.link.wait = lambda until, others: others
    rig.channel.gone = True
    rig.loop.run()
    assert rig.link.closed
