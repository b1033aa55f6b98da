"""The cycle of the streaming process: node, link and clock are played."""

import numpy as np
import pytest

from omniman_ros.arm.channel import ChannelError
from omniman_ros.arm.feedback import ArmSample
from omniman_ros.arm.loop import LATEST_REPORT, SILENT, TIMED, Order, StreamLoop
from omniman_ros.arm.parameters import PERIOD, UrParameters
from omniman_ros.arm.program_link import ProgramState
from omniman_ros.arm.report import Phase
from omniman_ros.core.arm_parameters import ArmParameters

from .test_streamer import HOME, PlayedLink

T0 = 200.0


class PlayedChannel:
    """A node: what it says is set, what it hears is kept."""

    def __init__(self):
        self.orders, self.reports = [], []
        self.gone = False

    def fileno(self):
        return 42

    def send(self, report):
        if self.gone:
            raise ChannelError("gone")
        self.reports.append(report)

    def receive(self):
        if self.gone:
            raise ChannelError("gone")
        orders, self.orders = self.orders, []
        return orders


class TimedLink(PlayedLink):
    """A controller that sends a sample each cycle; waiting is what lets time pass."""

    def __init__(self, channel):
        super().__init__()
        self.channel = channel
        self.now = T0
        self.late = 0.0
        self.ticks, self.waited = [], []
        self.counts, self.calls = {"skipped": 3}, {"second": 1}
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
            self.now, self.now, tuple(self.position), (0.0,) * 6, tuple(self.position),
            (0.0,) * 6, 7, 1, 2 if self.playing else 1, 1.0, len(served),
        )  # fmt: skip
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
        self.loop = StreamLoop(
            self.channel, self.link, ArmParameters(), UrParameters(), self.link.clock
        )
        self.loop.cycle()

    def order(self, do, *arguments):
        self.channel.orders.append(Order(do, arguments))

    def cycle(self, count=1, lives=True):
        for _ in range(count):
            if lives:
                self.order("live")
            self.loop.cycle()

    def preview(self, seconds=4.0, speed=0.3):
        """A motion that gathers speed and then goes on with it."""
        times = np.linspace(0.0, seconds, 200)
        gathered = np.minimum(times, 0.5)
        way = speed * (gathered**2 + np.maximum(times - 0.5, 0.0))
        rate = speed * np.minimum(2.0 * times, 1.0)
        whole = np.ones((1, 6))
        self.order(
            "preview", self.link.now + times, self.link.position + way[:, None] * whole,
            rate[:, None] * whole, None,
        )  # fmt: skip

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
    made.order("start")
    made.cycle(3)
    assert made.report.phase is Phase.STREAMING
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


def test_cycles_that_were_missed_are_made_up_for_at_once(rig):
    before = len(rig.link.sent)
    rig.link.late = 0.03
    rig.cycle()
    rig.cycle(3)
    assert len(rig.link.sent) - before == 4
    assert rig.report.phase is Phase.STREAMING


def test_being_held_up_for_long_stops_for_good(rig):
    moving(rig)
    rig.link.late = 1.0
    rig.cycle()
    rig.cycle()
    assert rig.report.stop_reason.startswith("held up for 1.0")
    assert rig.report.phase is Phase.IDLE


def test_a_sleep_of_the_machine_is_not_made_up_for(rig):
    rig.link.late = 3600.0
    rig.cycle()
    rig.cycle(2)
    assert rig.link.now - rig.loop._due < 2 * PERIOD


def test_what_is_new_is_reported_and_nothing_else(rig):
    first = rig.channel.reports[0]
    assert first.texts == ("hello",)
    assert first.counts == (("skipped", 3), ("second", 1))
    count = len(rig.channel.reports)
    rig.cycle(5)
    assert len(rig.channel.reports) == count + 5, "each sample is reported, and at once"
    assert all(len(report.samples) == 1 for report in rig.channel.reports[count:])
    rig.link.take_samples = lambda: []
    rig.cycle(round(1.0 / PERIOD))
    silent = len(rig.channel.reports) - count - 5
    assert silent <= 1.0 / LATEST_REPORT + 1
    assert silent >= 0.5 / LATEST_REPORT


def test_a_refusal_is_reported_once(rig):
    rig.preview()
    rig.channel.orders[-1].arguments[1][:] += 1.0
    rig.cycle(3)
    refusals = [why for report in rig.channel.reports for why in report.refusals]
    assert len(refusals) == 1 and "away from where it is led now" in refusals[0]


def test_punctuality_is_told_in_blocks(rig):
    rig.cycle(2 * TIMED + 2)
    told = [report.timing for report in rig.channel.reports if report.timing]
    assert [len(timing.intervals) for timing in told] == [TIMED, TIMED]
    assert np.allclose([timing.intervals for timing in told], PERIOD)
    assert told[1].ages


def test_a_report_knows_which_reset_it_follows(rig):
    rig.order("stop", "by hand")
    rig.cycle(3)
    assert (rig.report.stop_reason, rig.report.resets) == ("by hand", 0)
    rig.order("reset", 7)
    rig.cycle(3)
    assert (rig.report.stop_reason, rig.report.resets) == ("", 7)


def test_parameters_are_taken_over_live(rig):
    moving(rig)
    rig.order("configure", ArmParameters(velocity=(0.1,)), UrParameters())
    rig.cycle(2)
    assert "velocity" in rig.report.stop_reason


def test_a_node_that_says_nothing_has_the_arm_brought_to_rest(rig):
    moving(rig)
    since = rig.link.now
    while rig.speeds[-1] > 0.0:
        rig.cycle(lives=False)
        assert rig.link.now - since < SILENT + 0.15, "4 s of preview are left"
    assert rig.report.phase is Phase.STREAMING
    refusals = [why for report in rig.channel.reports for why in report.refusals]
    assert refusals == ["the arm is brought to rest: the node said nothing for 0.5 s"]
    rig.cycle(50)
    assert rig.speeds[-1] == 0.0, "its life alone moves nothing"
    rig.preview()
    rig.cycle(100)
    assert rig.speeds[-1] > 0.2


def test_a_node_that_lives_without_previews_has_one_followed_to_its_end(rig):
    moving(rig)
    rig.cycle(round(2.0 * SILENT / PERIOD))
    assert rig.speeds[-1] == pytest.approx(0.3, rel=0.01)


def test_without_its_node_it_brings_the_arm_to_rest_and_ends(rig):
    moving(rig)
    rig.channel.gone = True
    begin = rig.link.now
    rig.loop.run()
    assert rig.link.now - begin < 0.2
    assert rig.link.sent[-1][7] == -2
    assert rig.speeds[-1] == 0.0
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001
    assert rig.link.closed
    assert rig.link.waited[-1] == [], "a descriptor that is at its end would keep it awake"


def test_an_end_that_takes_too_long_is_one_all_the_same(rig):
    moving(rig)
    rig.order("configure", ArmParameters(acceleration=(0.011,)), UrParameters())
    rig.cycle()
    rig.channel.gone = True
    begin = rig.link.now
    rig.loop.run()
    assert rig.link.now - begin < 4.0
    assert rig.link.closed
