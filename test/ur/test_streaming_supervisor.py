"""Sending of setpoints and every stop reason, with a simulated link and injected time."""

import re
import struct

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.ur.feedback import ArmSample
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.program_link import ProgramState
from omniman_ros.ur.streaming_messages import StreamingPhase
from omniman_ros.ur.streaming_supervisor import StreamingSupervisor

HOME = (0.1, -1.0, 1.5, 0.0, 0.3, -2.0)
T0 = 50.0


class PlayedLink:
    """A simulated link to a controller whose arm follows at once."""

    def __init__(self):
        self.parameters = None
        self.blocking_reason, self.program_loss_reason = "", ""
        self.sample = None
        self.program = ProgramState.NONE
        self.address = ("10.0.0.2", 50001)
        self.texts, self.sent = [], []
        self.answers = True
        self.takes = True

    @property
    def connected(self):
        return not self.blocking_reason

    def start_program(self, text, now):
        self.texts.append(text)
        self.program = ProgramState.STARTING

    def end_program(self):
        self.program = ProgramState.NONE

    def send(self, data):
        if not self.takes:
            self.program, self.program_loss_reason = ProgramState.LOST, "it takes no more"
            return False
        self.sent.append(struct.unpack(">8i", data))
        return True


NAMED = 4  #: Number of periods after which the reason of a loss is determined


class Rig:
    """A streamer with its link, ticked in step with the controller's samples."""

    def __init__(self, **ur):
        self.link = PlayedLink()
        self.ur = UrParameters(**ur)
        self.streamer = StreamingSupervisor(self.link, ArmParameters(), self.ur)
        self.now = T0
        self.position = np.array(HOME)
        self.velocity = np.zeros(6)
        self.state = {"robot_mode": 7, "safety_mode": 1, "runtime_state": 1, "speed_scaling": 1.0}
        self.reads = True
        self.read = 0
        self.hear()

    def hear(self, **changes):
        self.link.sample = ArmSample(
            self.now,
            self.now - 20.0,
            tuple(self.position),
            tuple(self.velocity),
            tuple(self.position),
            (0.0,) * 6,
            **(self.state | changes),
            read=self.read,
        )
        self.streamer.check([self.link.sample], self.now)

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
                self.streamer.check([], self.now)

    def streaming(self):
        self.streamer.start(self.now)
        self.link.program = ProgramState.RUNNING
        self.state["runtime_state"] = 2
        self.hear()
        assert self.streamer.phase is StreamingPhase.STREAMING
        return self

    def preview(self, to=0.2, seconds=1.0):
        """Send previews of a smooth path of all joints that is `to` rad long."""
        times = self.now + np.linspace(0.0, seconds, 100)
        u = (times - self.now) / seconds
        scale = np.ones((1, 6))
        way = (to * (10 * u**3 - 15 * u**4 + 6 * u**5))[:, None] * scale
        rate = (to / seconds * (30 * u**2 - 60 * u**3 + 30 * u**4))[:, None] * scale
        self.streamer.follow(JointPreview(times, self.position + way, rate), self.now)

    @property
    def speeds(self):
        """Return the speed of the fastest joint between consecutive setpoints [rad/s]."""
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


def test_program_is_sent_and_connects_before_streaming():
    rig = Rig()
    rig.cycle(3)
    assert not rig.link.texts
    rig.streamer.start(rig.now)
    assert rig.streamer.phase is StreamingPhase.STARTING
    assert "10.0.0.2" in rig.link.texts[0]
    rig.cycle(3)
    assert not rig.link.sent


def test_first_setpoint_is_the_measured_position_and_is_kept(rig):
    rig.cycle(10)
    assert len(rig.link.sent) == 11
    for message in rig.link.sent:
        assert message == (40, *(round(1e6 * q) for q in HOME), 1)
    assert rig.streamer.at_rest


def test_preview_is_followed_to_its_end(rig):
    rig.preview(0.2)
    rig.cycle(130)
    assert rig.position == pytest.approx(np.array(HOME) + 0.2, abs=1e-5)
    assert not rig.streamer.take_refusals()
    assert rig.streamer.at_rest


def test_previews_before_the_start_and_after_the_end_are_rejected():
    rig = Rig()
    rig.preview()
    assert rig.streamer.take_refusals() == ("no setpoints are streamed (idle)",)
    rig.streaming()
    rig.streamer.stop("by hand")
    rig.cycle(3)
    rig.preview()
    assert rig.streamer.take_refusals() == ("no setpoints are streamed (stopped: by hand)",)


def settle(rig, cycles=100, **options):
    """Cycle until no more setpoints are sent; return their number."""
    before = len(rig.link.sent)
    for _ in range(cycles):
        rig.cycle(**options)
        if rig.streamer.phase is StreamingPhase.IDLE:
            break
    assert rig.streamer.phase is StreamingPhase.IDLE
    return len(rig.link.sent) - before


def test_stop_brakes_within_the_limit_then_ends_the_program(rig):
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
    assert rig.streamer.phase is StreamingPhase.IDLE
    assert rig.streamer.stop_reason == "by hand"


def test_reset_restarts_the_program_at_the_measured_position(rig):
    moving(rig)
    rig.streamer.stop("by hand")
    settle(rig)
    rig.velocity[:] = 0.0
    rig.position = rig.position + 0.01  # pushed by hand in the meantime
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


def test_reset_waits_for_rest_and_for_the_controller(rig):
    moving(rig)
    rig.streamer.stop("by hand")
    rig.streamer.reset(rig.now)
    assert rig.streamer.stop_reason
    settle(rig)
    rig.velocity[:] = 0.5
    rig.hear()
    rig.streamer.reset(rig.now)
    assert rig.streamer.stop_reason, "the arm is being pushed around"
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
def test_stop_by_the_controller_ends_streaming_at_once_and_latches(rig, change, why):
    moving(rig)
    before = len(rig.link.sent)
    rig.hear(**change)
    assert rig.link.program is ProgramState.NONE, "no queued setpoint may move the arm"
    assert rig.streamer.phase is StreamingPhase.IDLE
    rig.cycle(20)
    assert len(rig.link.sent) == before
    assert re.search(why, rig.streamer.stop_reason)


def test_lost_program_latches_a_stop(rig):
    moving(rig)
    before = len(rig.link.sent)
    rig.link.program, rig.link.program_loss_reason = ProgramState.LOST, "closed by the controller"
    rig.cycle(NAMED)
    assert rig.streamer.stop_reason == "closed by the controller"
    assert rig.streamer.phase is StreamingPhase.IDLE
    assert len(rig.link.sent) == before


def test_reason_of_a_loss_comes_from_a_later_controller_report(rig):
    moving(rig)
    before = len(rig.link.sent)
    rig.link.program, rig.link.program_loss_reason = ProgramState.LOST, "reset"
    rig.cycle()
    assert rig.streamer.stop_reason == ""
    rig.hear(safety_mode=3)
    assert rig.streamer.stop_reason == "safety mode: protective stop"
    assert rig.streamer.phase is StreamingPhase.IDLE
    assert len(rig.link.sent) == before


def test_controller_that_accepts_no_setpoints_latches_a_stop(rig):
    moving(rig)
    rig.link.takes = False
    rig.cycle(NAMED)
    assert rig.streamer.stop_reason == "it takes no more"


def test_missing_data_bring_the_arm_to_rest_and_end_the_program(rig):
    moving(rig)
    rig.link.blocking_reason = "no data for 0.08 s"
    settle(rig, data=False)
    assert rig.streamer.stop_reason == "no data for 0.08 s"
    assert rig.link.sent[-1][7] == -2
    assert rig.speeds[-1] == 0.0
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001


def test_program_that_reads_nothing_is_detected_within_100_ms(rig):
    rig.cycle(30)
    rig.reads = False
    since = rig.now
    for _ in range(100):
        rig.cycle()
        if rig.streamer.stop_reason:
            break
    assert rig.streamer.stop_reason == "the program reads no setpoints"
    assert rig.now - since <= 0.1


def test_program_not_reported_as_playing_is_detected():
    rig = Rig().streaming()
    rig.state["runtime_state"] = 1
    rig.streamer._has_played = False
    since = rig.now
    for _ in range(100):
        rig.cycle()
        if rig.streamer.stop_reason:
            break
    assert "does not report that the program plays" in rig.streamer.stop_reason
    assert rig.now - since <= 0.1


def test_arm_that_does_not_follow_is_stopped_within_the_limits(rig):
    rig.preview(0.6, 2.0)
    rig.cycle(60)
    rig.reads = False  # the arm stands and its program continues to read
    for _ in range(200):
        rig.read += 1
        rig.cycle()
        if rig.streamer.phase is not StreamingPhase.STREAMING:
            break
    assert "distance to measured" in rig.streamer.stop_reason
    settle(rig)
    assert rig.speeds[-1] == 0.0
    # Transmitted angles are whole microradians.
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD + 2e-6 / PERIOD


def test_higher_limits_apply_from_the_next_program_on(rig):
    rig.streamer.configure(ArmParameters(acceleration=(10.0,)), rig.ur)
    rig.preview(0.35, 0.5)  # up to 8.1 rad/s^2
    assert "the limit is 5 rad/s^2" in rig.streamer.take_refusals()[0]
    rig.streamer.finish()
    rig.cycle(2)
    rig.streaming().preview(0.35, 0.5)
    assert not rig.streamer.take_refusals()


@pytest.mark.parametrize("late", [1, 2, 3, 4])
def test_late_cycles_are_caught_up_without_a_jump(rig, late):
    moving(rig)
    for k in range(late):  # the loop sends one setpoint for each deadline that has passed
        rig.streamer.tick(rig.now + (k + 1) * PERIOD, rig.now + late * PERIOD)
    rig.now += late * PERIOD
    rig.cycle(3)
    assert rig.streamer.phase is StreamingPhase.STREAMING
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001


def test_delay_beyond_the_program_timeout_latches_a_stop(rig):
    moving(rig)
    rig.streamer.tick(rig.now + PERIOD, rig.now + PERIOD + 0.041)
    assert rig.streamer.stop_reason == "a setpoint was delayed by 0.041 s"
    assert rig.link.program is ProgramState.NONE


def test_hold_brakes_the_arm_with_the_program_running(rig):
    moving(rig)
    rig.streamer.hold(True)
    rig.cycle(60)
    assert rig.speeds[-1] == 0.0
    assert rig.streamer.phase is StreamingPhase.STREAMING
    rig.preview()
    assert rig.streamer.take_refusals() == ("the arm holds and accepts no previews",)
    rig.streamer.hold(False)
    rig.cycle(20)
    assert rig.speeds[-1] == 0.0
    rig.preview()
    rig.cycle(40)
    assert rig.speeds[-1] > 0.2


def test_streaming_started_during_a_hold_holds_the_arm():
    rig = Rig()
    rig.streamer.hold(True)
    rig.streaming().preview()
    assert rig.streamer.take_refusals() == ("the arm holds and accepts no previews",)


def test_failed_start_latches_no_stop_and_may_be_retried():
    rig = Rig()
    rig.hear(robot_mode=3)
    rig.streamer.start(rig.now)
    assert rig.streamer.failure == "robot mode: power off"
    assert rig.streamer.phase is StreamingPhase.IDLE
    rig.hear()
    rig.streamer.start(rig.now)
    rig.link.program, rig.link.program_loss_reason = ProgramState.LOST, "no call"
    rig.cycle()
    assert rig.streamer.failure == "no call"
    assert rig.streamer.stop_reason == ""
    rig.streamer.start(rig.now)
    assert rig.streamer.phase is StreamingPhase.STARTING


def test_failed_restart_after_a_reset_latches_a_stop(rig):
    rig.streamer.stop("by hand")
    settle(rig)
    rig.streamer.reset(rig.now)
    rig.link.program, rig.link.program_loss_reason = ProgramState.LOST, "no call"
    rig.cycle()
    assert rig.streamer.stop_reason == "no call"


def test_arm_beyond_its_limits_may_only_stay_or_return():
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


def test_finish_brings_the_arm_to_rest_first_and_latches_no_stop(rig):
    moving(rig)
    rig.streamer.finish()
    settle(rig)
    assert rig.speeds[-1] == 0.0
    assert rig.streamer.stop_reason == ""


def test_age_of_a_setpoint_refers_to_the_one_that_was_read(rig):
    rig.cycle(10)
    rig.streamer.ages.clear()
    rig.read = 8  # of 11
    rig.now += 0.001
    rig.hear()
    assert list(rig.streamer.ages) == pytest.approx([0.001 + 3 * PERIOD - 0.0002], abs=1e-6)


@pytest.mark.parametrize("lag", [0.0, 0.042, 0.1])
def test_setpoints_lead_the_preview_by_the_servo_lag(lag):
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
