"""When setpoints go out, and every reason to stop them; the link is played, time is injected."""

import re
import struct

import numpy as np
import pytest

from omniman_ros.arm.feedback import ArmSample
from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.arm.parameters import PERIOD, UrParameters
from omniman_ros.arm.program_link import ProgramState
from omniman_ros.arm.report import Phase
from omniman_ros.arm.streamer import ArmStreamer
from omniman_ros.core.arm_parameters import ArmParameters

HOME = (0.1, -1.0, 1.5, 0.0, 0.3, -2.0)
T0 = 50.0


class PlayedLink:
    """A controller and the connections to it, as this side sees them; the arm follows at once."""

    def __init__(self):
        self.parameters = None
        self.trouble, self.program_trouble = "", ""
        self.sample = None
        self.program = ProgramState.NONE
        self.address = ("10.0.0.2", 50001)
        self.texts, self.sent = [], []
        self.answers = True
        self.takes = True

    @property
    def connected(self):
        return not self.trouble

    def start_program(self, text, now):
        self.texts.append(text)
        self.program = ProgramState.STARTING

    def end_program(self):
        self.program = ProgramState.NONE

    def send(self, data):
        if not self.takes:
            self.program, self.program_trouble = ProgramState.LOST, "it takes no more"
            return False
        self.sent.append(struct.unpack(">8i", data))
        return True


NAMED = 4
"""Periods after which a loss has its name."""


class Rig:
    """A streamer with its link, ticked in step with the controller's samples."""

    def __init__(self, **ur):
        self.link = PlayedLink()
        self.ur = UrParameters(**ur)
        self.streamer = ArmStreamer(self.link, ArmParameters(), self.ur)
        self.now = T0
        self.position = np.array(HOME)
        self.velocity = np.zeros(6)
        self.state = {"robot_mode": 7, "safety_mode": 1, "runtime_state": 1, "speed_scaling": 1.0}
        self.reads = True
        self.read = 0
        self.hear()

    def hear(self, **changes):
        self.link.sample = ArmSample(
            self.now, self.now - 20.0, tuple(self.position), tuple(self.velocity),
            tuple(self.position), (0.0,) * 6, **(self.state | changes), read=self.read,
        )  # fmt: skip
        self.streamer.watch([self.link.sample], self.now)

    def cycle(self, count=1, data=True):
        for _ in range(count):
            self.now += PERIOD
            before = len(self.link.sent)
            self.streamer.tick(self.now, self.now + 0.0002)
            new = self.link.sent[before:]
            if new and self.reads:
                place = np.array(new[-1][1:7]) * 1e-6
                self.velocity, self.position = (place - self.position) / PERIOD, place
                self.read += sum(message[7] == 1 for message in new)
            if data:
                self.hear()
            else:
                self.streamer.watch([], self.now)

    def streaming(self):
        self.streamer.start(self.now)
        self.link.program = ProgramState.RUNNING
        self.state["runtime_state"] = 2
        self.hear()
        assert self.streamer.phase is Phase.STREAMING
        return self

    def preview(self, to=0.2, seconds=1.0):
        """Previews of a smooth way of all joints that is `to` rad long."""
        times = self.now + np.linspace(0.0, seconds, 100)
        u = (times - self.now) / seconds
        scale = np.ones((1, 6))
        way = (to * (10 * u**3 - 15 * u**4 + 6 * u**5))[:, None] * scale
        rate = (to / seconds * (30 * u**2 - 60 * u**3 + 30 * u**4))[:, None] * scale
        self.streamer.preview(JointPreview(times, self.position + way, rate), self.now)

    @property
    def speeds(self):
        """Fastest joint between each two setpoints, rad/s."""
        places = np.array([message[1:7] for message in self.link.sent if message[7] == 1]) * 1e-6
        return np.abs(np.diff(places, axis=0)).max(axis=1) / PERIOD


@pytest.fixture
def rig():
    return Rig().streaming()


def moving(rig):
    rig.preview()
    rig.cycle(40)
    assert rig.speeds[-1] > 0.2
    return rig


def test_the_program_is_sent_and_calls_before_anything_is_streamed():
    rig = Rig()
    rig.cycle(3)
    assert not rig.link.texts
    rig.streamer.start(rig.now)
    assert rig.streamer.phase is Phase.STARTING
    assert "10.0.0.2" in rig.link.texts[0]
    rig.cycle(3)
    assert not rig.link.sent


def test_the_first_setpoint_is_the_measured_place_and_is_held(rig):
    rig.cycle(10)
    assert len(rig.link.sent) == 11
    for message in rig.link.sent:
        assert message == (40, *(round(1e6 * q) for q in HOME), 1)
    assert rig.streamer.at_rest


def test_a_preview_is_followed_to_its_end(rig):
    rig.preview(0.2)
    rig.cycle(130)
    assert rig.position == pytest.approx(np.array(HOME) + 0.2, abs=1e-5)
    assert not rig.streamer.take_refusals()
    assert rig.streamer.at_rest


def test_nothing_is_followed_before_and_after():
    rig = Rig()
    rig.preview()
    assert rig.streamer.take_refusals() == ("no setpoints are streamed (idle)",)
    rig.streaming()
    rig.streamer.stop("by hand")
    rig.cycle(3)
    rig.preview()
    assert rig.streamer.take_refusals() == ("no setpoints are streamed (stopped: by hand)",)


def settle(rig, cycles=100, **options):
    """Cycle until no setpoints are sent; how many were."""
    before = len(rig.link.sent)
    for _ in range(cycles):
        rig.cycle(**options)
        if rig.streamer.phase is Phase.IDLE:
            break
    assert rig.streamer.phase is Phase.IDLE
    return len(rig.link.sent) - before


def test_a_stop_brakes_within_the_limit_then_ends_the_program(rig):
    moving(rig)
    speed = rig.speeds[-1]
    rig.streamer.stop("by hand")
    count = settle(rig)
    assert rig.link.sent[-1][7] == -2
    assert count <= speed / (0.9 * 5.0) / PERIOD + 4
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001
    assert rig.speeds[-1] == 0.0
    assert rig.link.program is ProgramState.NONE
    rig.cycle(50)
    assert rig.streamer.phase is Phase.IDLE
    assert rig.streamer.stop_reason == "by hand"


def test_after_a_reset_the_program_begins_anew_where_the_arm_is(rig):
    moving(rig)
    rig.streamer.stop("by hand")
    settle(rig)
    rig.velocity[:] = 0.0
    rig.position = rig.position + 0.01  # pushed by hand meanwhile
    rig.hear(runtime_state=1)
    before = len(rig.link.sent)
    rig.streamer.reset(rig.now)
    assert rig.streamer.stop_reason == ""
    rig.link.program = ProgramState.RUNNING
    rig.read = 0
    rig.hear()
    rig.cycle(20)
    assert len(rig.link.texts) == 2
    place = np.round(rig.position * 1e6)
    assert all((np.array(m[1:7]) == place).all() for m in rig.link.sent[before:])


def test_a_reset_waits_for_rest_and_for_the_controller(rig):
    moving(rig)
    rig.streamer.stop("by hand")
    rig.streamer.reset(rig.now)
    assert rig.streamer.stop_reason
    settle(rig)
    rig.velocity[:] = 0.5
    rig.hear()
    rig.streamer.reset(rig.now)
    assert rig.streamer.stop_reason, "it is pushed around"
    rig.velocity[:] = 0.0
    rig.hear(safety_mode=3)
    rig.streamer.reset(rig.now)
    assert rig.streamer.stop_reason
    rig.hear()
    rig.streamer.reset(rig.now)
    assert not rig.streamer.stop_reason


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"safety_mode": 3}, "safety mode: protective stop"),
        ({"safety_mode": 7}, "safety mode: robot emergency stop"),
        ({"safety_mode": 6}, "safety mode: system emergency stop"),
        ({"safety_mode": 42}, r"safety mode: unknown \(42\)"),
        ({"robot_mode": 3}, "robot mode: power off"),
        ({"runtime_state": 4}, "the program is paused"),
        ({"runtime_state": 1}, "the program is stopped"),
    ],
)
def test_what_the_controller_stops_by_itself_is_left_at_once_and_for_good(rig, change, why):
    moving(rig)
    before = len(rig.link.sent)
    rig.hear(**change)
    assert rig.link.program is ProgramState.NONE, "nothing that waits in it may move the arm"
    assert rig.streamer.phase is Phase.IDLE
    rig.cycle(20)
    assert len(rig.link.sent) == before
    assert re.search(why, rig.streamer.stop_reason)


def test_a_program_that_is_lost_stops_for_good(rig):
    moving(rig)
    before = len(rig.link.sent)
    rig.link.program, rig.link.program_trouble = ProgramState.LOST, "closed by the controller"
    rig.cycle(NAMED)
    assert rig.streamer.stop_reason == "closed by the controller"
    assert rig.streamer.phase is Phase.IDLE
    assert len(rig.link.sent) == before


def test_a_loss_is_named_by_what_the_controller_says_of_it_a_little_later(rig):
    moving(rig)
    before = len(rig.link.sent)
    rig.link.program, rig.link.program_trouble = ProgramState.LOST, "reset"
    rig.cycle()
    assert rig.streamer.stop_reason == ""
    rig.hear(safety_mode=3)
    assert rig.streamer.stop_reason == "safety mode: protective stop"
    assert rig.streamer.phase is Phase.IDLE
    assert len(rig.link.sent) == before


def test_a_controller_that_takes_no_setpoints_stops_for_good(rig):
    moving(rig)
    rig.link.takes = False
    rig.cycle(NAMED)
    assert rig.streamer.stop_reason == "it takes no more"


def test_without_data_the_arm_is_brought_to_rest_and_the_program_ended(rig):
    moving(rig)
    rig.link.trouble = "no data for 0.08 s"
    settle(rig, data=False)
    assert rig.streamer.stop_reason == "no data for 0.08 s"
    assert rig.link.sent[-1][7] == -2
    assert rig.speeds[-1] == 0.0
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001


def test_a_program_that_reads_nothing_is_noticed_within_100_ms(rig):
    rig.cycle(30)
    rig.reads = False
    since = rig.now
    for _ in range(100):
        rig.cycle()
        if rig.streamer.stop_reason:
            break
    assert rig.streamer.stop_reason == "the program reads no setpoints"
    assert rig.now - since <= 0.1


def test_a_program_that_is_not_said_to_play_is_noticed():
    rig = Rig().streaming()
    rig.state["runtime_state"] = 1
    rig.streamer._played = False
    since = rig.now
    for _ in range(100):
        rig.cycle()
        if rig.streamer.stop_reason:
            break
    assert "does not say that the program plays" in rig.streamer.stop_reason
    assert rig.now - since <= 0.1


def test_an_arm_that_does_not_follow_is_stopped_within_the_limits(rig):
    rig.preview(0.6, 2.0)
    rig.cycle(60)
    rig.reads = False  # it stands, and its program goes on reading
    for _ in range(200):
        rig.read += 1
        rig.cycle()
        if rig.streamer.phase is not Phase.STREAMING:
            break
    assert "distance to measured" in rig.streamer.stop_reason
    settle(rig)
    assert rig.speeds[-1] == 0.0
    # Angles on the wire are whole microradians.
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD + 2e-6 / PERIOD


@pytest.mark.parametrize("late", [1, 2, 3, 4])
def test_cycles_that_come_late_are_caught_up_without_a_jump(rig, late):
    moving(rig)
    for k in range(late):  # the loop sends one setpoint for each deadline that has passed
        rig.streamer.tick(rig.now + (k + 1) * PERIOD, rig.now + late * PERIOD)
    rig.now += late * PERIOD
    rig.cycle(3)
    assert rig.streamer.phase is Phase.STREAMING
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001


def test_being_held_up_for_longer_than_the_program_waits_stops_for_good(rig):
    moving(rig)
    rig.streamer.tick(rig.now + PERIOD, rig.now + PERIOD + 0.041)
    assert rig.streamer.stop_reason == "held up for 0.041 s"
    assert rig.link.program is ProgramState.NONE


def test_held_it_brakes_and_stands_with_the_program_running(rig):
    moving(rig)
    rig.streamer.hold(True)
    rig.cycle(60)
    assert rig.speeds[-1] == 0.0
    assert rig.streamer.phase is Phase.STREAMING
    rig.preview()
    assert rig.streamer.take_refusals() == ("the arm is held",)
    rig.streamer.hold(False)
    rig.cycle(20)
    assert rig.speeds[-1] == 0.0
    rig.preview()
    rig.cycle(40)
    assert rig.speeds[-1] > 0.2


def test_what_begins_while_held_is_held():
    rig = Rig()
    rig.streamer.hold(True)
    rig.streaming().preview()
    assert rig.streamer.take_refusals() == ("the arm is held",)


def test_a_start_that_fails_latches_nothing_and_may_be_tried_again():
    rig = Rig()
    rig.hear(robot_mode=3)
    rig.streamer.start(rig.now)
    assert rig.streamer.failure == "robot mode: power off"
    assert rig.streamer.phase is Phase.IDLE
    rig.hear()
    rig.streamer.start(rig.now)
    rig.link.program, rig.link.program_trouble = ProgramState.LOST, "no call"
    rig.cycle()
    assert rig.streamer.failure == "no call"
    assert rig.streamer.stop_reason == ""
    rig.streamer.start(rig.now)
    assert rig.streamer.phase is Phase.STARTING


def test_a_restart_after_a_reset_that_fails_is_a_stop(rig):
    rig.streamer.stop("by hand")
    settle(rig)
    rig.streamer.reset(rig.now)
    rig.link.program, rig.link.program_trouble = ProgramState.LOST, "no call"
    rig.cycle()
    assert rig.streamer.stop_reason == "no call"


def test_an_arm_beyond_its_limits_is_held_and_led_back_only():
    rig = Rig()
    rig.position = np.array([0.0, 0.0, 3.5, 0.0, 0.0, 0.0])
    rig.hear()
    rig.streaming()
    rig.cycle(5)
    rig.preview(0.1)
    (refusal,) = rig.streamer.take_refusals()
    assert "elbow_joint: position" in refusal
    rig.preview(-0.1)
    rig.cycle(130)
    assert not rig.streamer.take_refusals()
    assert rig.position[2] == pytest.approx(3.4, abs=1e-5)


def test_finishing_brings_it_to_rest_first_and_latches_nothing(rig):
    moving(rig)
    rig.streamer.finish()
    settle(rig)
    assert rig.speeds[-1] == 0.0
    assert rig.streamer.stop_reason == ""


def test_the_age_of_a_setpoint_is_that_of_the_one_that_was_read(rig):
    rig.cycle(10)
    rig.streamer.ages.clear()
    rig.read = 8  # of 11
    rig.now += 0.001
    rig.hear()
    assert list(rig.streamer.ages) == pytest.approx([0.001 + 3 * PERIOD - 0.0002], abs=1e-6)


@pytest.mark.parametrize("lag", [0.0, 0.042, 0.1])
def test_setpoints_are_ahead_of_the_preview_by_the_servos_lag(lag):
    rig = Rig(servo_lag=lag).streaming()
    rig.cycle(3)
    begin = rig.now
    rig.preview(to=0.2, seconds=2.0)
    rig.cycle(120)
    u = (rig.now - begin + lag) / 2.0
    way = 0.2 * (10 * u**3 - 15 * u**4 + 6 * u**5)
    assert np.array(rig.link.sent[-1][1:7]) * 1e-6 == pytest.approx(
        HOME + way * np.ones(6), abs=1e-5
    )
