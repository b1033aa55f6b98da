import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.limits import ratio
from omniman_ros.control.platform import LATE, LATE_DELIVERY, MAX_TICK, WAITED
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core import se2
from omniman_ros.core.arbiter import Source
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build, flatten, specs
from omniman_ros.core.preview import Preview
from omniman_ros.core.stop import ResetRefusedError, StopState
from test.control.rig import DT, Rig, finite, with_robot
from test.robots import ALL, parameters, random_robot
from test.tiers import combinations, representative

NAN, INF = math.nan, math.inf
CRUISE = (0.5, -0.3, 0.4)
SLACK = 1 + 1e-6


def driving(**options):
    """Return a rig that drives by cmd_vel at a constant twist."""
    rig = Rig(**options).cruise(*CRUISE)
    np.testing.assert_array_equal(rig.core.setpoint, CRUISE)
    return rig


def following(source=Source.PATH, seconds=5.0):
    """Return a rig that follows a preview at constant speed; the preview ends in motion."""
    rig = Rig().run(0.1)
    assert rig.core.set_preview(source, rig.line((0.4, 0.2, 0.3), seconds), rig.now) == ""
    rig.run(3.0)
    assert np.linalg.norm(rig.core.setpoint[:2]) == pytest.approx(math.hypot(0.4, 0.2), abs=1e-3)
    return rig


def decelerates(rig, since):
    """Assert that the twist ramps within limits to exactly zero from tick `since` and stays."""
    limits, model = rig.core.parameters.limits, rig.core.cascade.kinematics
    twists = rig.setpoints[since - 1 :]
    allowed = ratio(twists[0], limits.deceleration)
    speeds = [model.J @ twist for twist in twists]
    for before, after in itertools.pairwise(twists):
        assert ratio(before - after, limits.deceleration) <= DT * SLACK
        np.testing.assert_allclose(np.cross(after, twists[0]), 0, atol=1e-9)
    for before, after in itertools.pairwise(speeds):
        assert (abs(after) <= abs(before) + 1e-12).all()  # applies to every wheel at every tick
    rest = next(i for i, twist in enumerate(twists) if not twist.any())
    assert rest <= math.ceil(allowed / DT + 1e-6)
    for twist, command in zip(twists[1:], rig.commands[since:], strict=True):
        assert command.mode is DriveMode.VELOCITY  # with zero torque the wheels would coast
        assert finite(command)
        np.testing.assert_allclose(model.J_pinv @ command.velocity, twist, atol=1e-9)
    for command in rig.commands[since + rest :]:
        assert not command.velocity.any()
        assert not command.effort.any()
    assert rig.still
    return rest * DT


# ---- driving ----------------------------------------------------------------------------------


def test_robot_stands_after_start():
    rig = Rig()
    rig.run(0.5)
    assert rig.still
    assert rig.core.arbiter.active is None
    assert rig.core.at_rest


def test_robot_stands_without_wheel_states():
    rig = Rig()
    rig.reports = False
    assert rig.twist(*CRUISE) == "no wheel_states yet"
    preview = rig.line((0.3, 0, 0), 2.0)
    assert rig.core.set_preview(Source.PATH, preview, rig.now) == "no wheel_states yet"
    assert rig.core.set_voltages(np.ones(4), rig.now) == "no wheel_states yet"
    rig.run(1.0, lambda: rig.twist(*CRUISE))
    assert all(not twist.any() for twist in rig.setpoints)


def test_robot_is_ready_once_wheels_and_limit_report_and_nothing_is_stopped():
    rig = Rig(changes={"collision_monitor.use": True})
    rig.reports = False
    rig.run(0.1)
    rig.core.motion_limit.update(1.0, rig.now, rig.now)
    assert not rig.core.is_ready(rig.now), "no wheel_states"
    rig.reports = True
    rig.run(0.1)
    assert rig.core.is_ready(rig.now)
    rig.core.latch.stop("button")
    assert not rig.core.is_ready(rig.now)
    rig.core.reset(rig.now)
    assert rig.core.is_ready(rig.now)
    assert not rig.core.is_ready(rig.now + 1.0), "no fresh motion_limit"


def test_twist_of_round_off_asks_for_rest():
    rig = Rig()
    rig.run(0.5, lambda: rig.twist(*CRUISE))
    rig.run(2.0, lambda: rig.twist(3e-6, -5e-5, 1e-17))
    assert rig.core.at_rest


def test_twist_of_zero_is_accepted_before_the_first_wheel_states():
    rig = Rig()
    rig.reports = False
    answers = set()
    rig.run(1.0, lambda: answers.add(rig.twist(0, 0, 0)))
    assert answers == {""}
    assert rig.core.arbiter.active is None
    assert set(rig.commands) == {None}
    rig.reports = True
    rig.run(0.1)
    assert rig.twist(*CRUISE) == ""


@pytest.mark.parametrize("robot", ALL)
def test_cmd_vel_is_followed_within_limits_and_odometry_gives_the_pose(robot):
    rig = Rig(robot).cruise(*CRUISE, seconds=3.0)
    limits = rig.core.parameters.limits
    twists = np.array([np.zeros(3), *rig.setpoints])
    acceleration = np.diff(twists, axis=0) / DT
    assert max(ratio(row, limits.acceleration) for row in acceleration) <= SLACK
    jerk = np.diff(acceleration, axis=0) / DT
    assert max(ratio(row, limits.jerk) for row in jerk) <= SLACK
    np.testing.assert_array_equal(rig.core.setpoint, CRUISE)
    pose = np.zeros(3)
    for twist in rig.setpoints[:-1]:  # the latest command has not been driven yet
        dx, dy, turn = se2.arc(twist * DT)
        pose = pose + np.append(se2.to_world(pose[2], np.array([dx, dy, 0]))[:2], turn)
    assert rig.core.odometry.pose == pytest.approx(tuple(pose), abs=1e-9)
    np.testing.assert_allclose(rig.core.odometry.twist, CRUISE, atol=1e-9)


@pytest.mark.parametrize("n", representative(range(3, 9), every=2))
def test_platforms_with_any_wheels_drive_follow_and_stop(n):
    rig = Rig(with_robot(random_robot(np.random.default_rng(n), n)))
    rig.cruise(*CRUISE)
    assert rig.core.odometry.twist == pytest.approx(CRUISE)
    since = len(rig.commands)
    rig.core.latch.stop("button")
    decelerates(rig.run(1.5), since)
    rig.core.reset(rig.now)
    rig.run(1.0)
    goal = (0.5, -0.4, 0.6)
    start = np.array(rig.core.odometry.pose)
    assert rig.core.set_preview(Source.PATH, rig.move(goal, 3.0), rig.now) == ""
    rig.run(4.0)
    np.testing.assert_allclose(rig.core.odometry.pose, start + goal, atol=1e-3)
    assert rig.still


def test_twist_beyond_the_limits_keeps_its_direction():
    rig = Rig().cruise(30.0, 40.0, 0.0, seconds=4.0)
    np.testing.assert_allclose(rig.core.setpoint, [0.6, 0.8, 0])
    assert not rig.core.cascade.saturated


def test_computed_torque_is_fed_forward_with_the_speeds():
    rig = driving()
    cascade = rig.core.cascade
    twist = rig.core.setpoint
    expected = cascade.dynamics.platform_torque(twist, np.zeros(3))
    expected = expected + cascade.dynamics.friction_torque(twist, cascade.kinematics.J @ twist)
    np.testing.assert_allclose(rig.commands[-1].effort, expected)


@pytest.mark.parametrize("mode", ["torque", "voltage"])
def test_other_modes_drive_and_stop_in_velocity_mode(mode):
    rig = driving(changes={"drive.mode": mode})
    assert {command.mode.value for command in rig.commands[10:]} == {mode}
    since = len(rig.commands)
    rig.core.latch.stop("button")
    decelerates(rig.run(1.5), since)


@pytest.mark.parametrize("offset", [0.0, 1e-4, 3.7])
def test_late_and_backward_ticks_cause_no_jump(offset):
    rig = driving()
    before = rig.core.setpoint
    command = rig.core.tick(rig.now - offset)  # not after the latest tick
    assert finite(command)
    np.testing.assert_allclose(rig.core.setpoint, before)


def test_slightly_late_tick_counts_in_full():
    rig = driving()
    rig.core.latch.stop("button")
    before = rig.core.setpoint
    rig.core.tick(rig.now + 0.9 * MAX_TICK)
    spent = ratio(before - rig.core.setpoint, rig.core.parameters.limits.deceleration)
    assert spent == pytest.approx(0.9 * MAX_TICK)


def test_no_command_after_a_stall_until_the_wheels_have_reported():
    rig = driving()
    rig.now += 0.9  # the drives have stopped by themselves in the meantime
    assert rig.core.tick(rig.now) is None
    # A report from before the end of the stall.
    rig.core.update_wheels(rig.now - DT, rig.now, rig.position, rig.speed)
    assert rig.core.tick(rig.now + DT) is None
    assert rig.core.latch.released
    rig.now += DT
    rig.speed = np.zeros(rig.count)
    rig.report()
    rig.twist(*CRUISE)
    command = rig.core.tick(rig.now + DT)
    assert command is not None and command.velocity is not None
    bound = abs(rig.core.cascade.kinematics.J).sum() * 0.1
    assert abs(command.velocity).max() < bound * DT * 50
    assert ratio(rig.core.setpoint, rig.core.parameters.limits.acceleration) <= 2 * DT


def test_there_is_no_command_before_any_wheel_states_nor_after_a_stall_without_them():
    rig = Rig()
    for now in (rig.now, rig.now + DT, rig.now + 0.9, rig.now + 0.9 + DT):
        assert rig.core.tick(now) is None


def test_controller_that_starts_while_the_wheels_turn_brakes_within_the_limit():
    rig = Rig()
    rig.speed = rig.core.cascade.kinematics.J @ np.array([0.5, 0.0, 0.0])
    rig.run(1.5)
    speeds = np.array([0.5, *(twist[0] for twist in rig.setpoints)])
    assert speeds[1] > 0.45
    assert speeds[-1] == 0.0
    assert rig.still
    linear, _ = rig.core.limits.deceleration
    assert -np.diff(speeds).min() <= linear * DT * (1 + 1e-9)


def test_stall_of_the_controller_does_not_make_its_sources_stale():
    rig = driving()
    rig.core.arbiter.cancel(Source.CMD_VEL, "test")
    rig.now += 5.0
    rig.core.tick(rig.now)
    rig.report()
    assert "test" in rig.core.set_twist(np.array([0.1, 0.0, 0.0]), rig.now + DT)


def stalled(rig, seconds=0.9):
    """Let the controller stall while the drives stop, up to the instant before its late tick."""
    rig.now += seconds
    rig.speed = np.zeros(rig.count)
    return rig


def resume(rig):
    """Run the late tick, and report the wheels after it; the next tick resumes the motion."""
    assert rig.core.tick(rig.now) is None
    rig.now += DT
    rig.report()


UNSTAMPED = {
    "a twist": lambda rig: rig.twist(*CRUISE),
    "a preview": lambda rig: rig.core.set_preview(
        Source.PATH, rig.line((0.3, 0, 0), 9.0), rig.now, stamped=False
    ),
    "voltages": lambda rig: rig.core.set_voltages(np.ones(rig.count), rig.now),
}
STAMPED = {
    "a twist": lambda rig: rig.twist(*CRUISE, age=0.1),
    "a preview": lambda rig: rig.core.set_preview(
        Source.PATH, rig.line((0.3, 0, 0), 9.0), rig.now
    ),
    "voltages": lambda rig: rig.core.set_voltages(np.ones(rig.count), rig.now, 0.01),
}
ARRIVALS = {
    "before the late tick": lambda rig: None,
    "after the late tick": lambda rig: rig.core.tick(rig.now),
    "after the report that ends the stall": resume,
}
BOTH_MODES = {"drive.offered": ("velocity", "voltage")}


@pytest.mark.parametrize("arrival", ARRIVALS)
@pytest.mark.parametrize("kind", UNSTAMPED)
def test_unstamped_input_that_waited_during_a_stall_does_not_drive(kind, arrival):
    rig = stalled(Rig(changes=BOTH_MODES).run(0.1))
    ARRIVALS[arrival](rig)
    assert UNSTAMPED[kind](rig) == WAITED
    for _ in range(200):
        if rig.core.tick(rig.now) is not None:
            assert rig.core.arbiter.active is None and not rig.core.setpoint.any()
        rig.now += DT
        rig.report()
    assert UNSTAMPED[kind](rig) == ""
    rig.tick()
    assert rig.core.arbiter.active is not None


@pytest.mark.parametrize("arrival", ARRIVALS)
@pytest.mark.parametrize("kind", STAMPED)
def test_stamped_input_drives_on_after_a_stall(kind, arrival):
    rig = stalled(Rig(changes=BOTH_MODES).run(0.1))
    ARRIVALS[arrival](rig)
    assert STAMPED[kind](rig) == ""
    if rig.core.tick(rig.now) is None:
        rig.run(DT)
    assert rig.core.arbiter.active is not None


@pytest.mark.parametrize("arrival", ARRIVALS)
def test_zero_twist_is_used_during_a_stall(arrival):
    rig = stalled(driving(), 0.3)  # so that the twist from before is not stale yet
    ARRIVALS[arrival](rig)
    assert rig.twist(0, 0, 0, sent=rig.now - 0.2) == ""
    assert rig.core.tick(rig.now) is None or not rig.core.setpoint.any()
    rig.run(0.1)
    assert rig.core.arbiter.active is Source.CMD_VEL and not rig.core.setpoint.any()


def test_twist_that_is_ignored_after_a_stall_does_not_count_as_fresh():
    rig = stalled(driving(), 0.3)
    timeout = rig.core.parameters.timeouts.cmd_vel
    assert rig.twist(*CRUISE) == WAITED
    resume(rig)
    rig.core.tick(rig.now)
    assert rig.core.arbiter.active is Source.CMD_VEL, "the twist from before is not stale yet"
    rig.run(timeout - 0.3 + 2 * DT)
    assert rig.core.arbiter.active is None


def test_twist_sent_before_the_end_of_a_stall_is_not_used_however_late_it_comes():
    rig = stalled(driving(), 2.0)
    end = rig.now
    resume(rig)
    rig.run(2.0)
    assert rig.twist(*CRUISE, sent=end - 0.01) == WAITED
    assert rig.twist(0, 0, 0, sent=end - 0.01) == ""
    assert rig.twist(*CRUISE, sent=rig.now - 0.01) == ""
    assert rig.twist(*CRUISE, age=0.1, sent=end - 0.01) == "", "a stamp takes precedence"


def test_sender_whose_clock_is_behind_drives_again_some_time_after_a_stall():
    rig = stalled(driving())
    end = rig.now
    resume(rig)
    rig.run(LATE_DELIVERY - 2 * DT, lambda: rig.twist(*CRUISE, sent=rig.now - 60.0))
    assert not rig.core.setpoint.any() and rig.now < end + LATE_DELIVERY
    rig.run(0.2, lambda: rig.twist(*CRUISE, sent=rig.now - 60.0))
    assert rig.core.setpoint.any()


def test_twist_that_is_delivered_late_is_not_used_unless_it_is_zero():
    rig = Rig().run(0.1)
    late = rig.now - rig.core.parameters.timeouts.cmd_vel - 0.01
    assert rig.twist(*CRUISE, sent=late) == LATE
    assert rig.twist(0, 0, 0, sent=late) == ""
    assert rig.twist(*CRUISE, age=0.1, sent=late) == "", "a stamp takes precedence"
    assert rig.twist(*CRUISE, sent=rig.now) == ""


def test_silence_of_the_wheels_counts_from_the_end_of_a_stall():
    rig = stalled(driving(), 2.0)
    timeout = rig.core.parameters.timeouts.wheel_states
    end = rig.now
    while rig.now < end + timeout - DT:
        assert rig.core.tick(rig.now) is None
        assert rig.core.latch.released
        rig.now += DT
    for _ in range(3):
        rig.core.tick(rig.now)
        rig.now += DT
    assert "wheel_states silent" in rig.core.latch.status.reason


# ---- stopping ---------------------------------------------------------------------------------


def silence(rig):
    """Let cmd_vel become stale, 0.5 s after the latest message."""
    rig.run(0.48)
    assert rig.core.setpoint == pytest.approx(CRUISE)
    while rig.core.arbiter.active is not None:
        rig.tick()


def stuck(rig):
    ideal = rig.ideal

    def drive(command):
        speeds = np.array(ideal(command))
        speeds[1] = 0.0
        return speeds

    rig.drive = drive
    rig.run(0.6, lambda: rig.twist(*CRUISE))
    rig.drive = ideal


LATCHED = {
    "button": lambda rig: rig.core.latch.stop("button"),
    "emergency": lambda rig: rig.core.latch.set_emergency(True),
}


@pytest.mark.parametrize("way", LATCHED)
def test_latched_stop_ramps_every_wheel_to_zero_and_stays(way):
    rig = driving()
    since = len(rig.commands)
    LATCHED[way](rig)
    rig.run(3.0, lambda: rig.twist(*CRUISE))  # the stream continues
    assert 0.3 < decelerates(rig, since) < 0.6
    assert rig.core.latch.status.state is StopState.STOPPED


def test_stopped_peer_holds_the_robot_and_its_release_starts_no_motion():
    rig = driving()
    since = len(rig.commands)
    rig.core.latch.set_peer("arm_streamer", True, "button")
    rig.run(1.5, lambda: rig.twist(*CRUISE))
    rig.core.latch.set_peer("arm_streamer", False)
    rig.run(1.5, lambda: rig.twist(*CRUISE))  # the old stream continues
    decelerates(rig, since)
    rig.run(1.1)  # a pause in the stream
    rig.run(0.1, lambda: rig.twist(*CRUISE))
    assert rig.core.setpoint.any()


def test_stale_cmd_vel_ramps_down_and_the_next_one_drives_again():
    rig = driving()
    silence(rig)
    since = len(rig.commands) - 1
    decelerates(rig.run(1.5), since)
    assert rig.core.latch.released
    assert rig.twist(*CRUISE) == ""
    rig.run(0.1)
    assert rig.core.setpoint.any()


def test_zero_cmd_vel_brings_the_robot_exactly_to_rest():
    rig = driving()
    rig.cruise(0, 0, 0, seconds=1.5)
    assert not rig.core.setpoint.any()
    assert not rig.commands[-1].velocity.any()
    assert rig.core.at_rest


def test_lost_wheel_states_latch_a_stop_that_can_be_reset():
    rig = driving()
    rig.reports = False
    since = len(rig.commands)
    ticks = 0
    while rig.core.latch.released:
        rig.twist(*CRUISE)
        rig.tick()
        ticks += 1
    assert ticks * DT == pytest.approx(0.2, abs=2 * DT)
    since += ticks - 1
    rig.run(2.0, lambda: rig.twist(*CRUISE))
    decelerates(rig, since)
    assert "wheel_states silent" in rig.core.latch.status.reason
    with pytest.raises(ResetRefusedError, match="wheel_states silent"):
        rig.core.reset(rig.now)
    rig.reports = True
    rig.run(0.1)
    rig.core.reset(rig.now)
    assert rig.core.latch.released
    assert rig.still


def test_late_wheel_states_count_as_lost():
    rig = driving()
    rig.reports = False
    for _ in range(100):
        rig.now += DT
        rig.twist(*CRUISE)
        late = rig.now - 0.25
        if late > rig.core.feedback.time:
            rig.core.update_wheels(late, rig.now, rig.position, rig.speed)
        rig.core.tick(rig.now)
    assert "wheel_states silent" in rig.core.latch.status.reason


def test_wheel_states_may_be_interrupted_at_rest():
    rig = Rig().run(1.0)
    rig.reports = False
    rig.run(1.0)
    assert rig.core.latch.released
    assert rig.twist(*CRUISE) == "no wheel_states yet"
    rig.position = rig.position + 50.0  # the drives were restarted at another position
    rig.reports = True
    rig.run(0.7)
    assert rig.core.odometry.pose == (0, 0, 0)
    assert rig.twist(*CRUISE) == ""


def test_wheel_states_may_be_interrupted_while_cmd_vel_asks_for_rest():
    rig = Rig().run(0.1)
    rig.run(0.2, lambda: rig.twist(0, 0, 0))
    assert rig.core.arbiter.active is Source.CMD_VEL
    rig.reports = False
    rig.run(1.0, lambda: rig.twist(0, 0, 0))
    assert rig.core.latch.released
    assert rig.twist(0, 0, 0) == ""
    assert rig.twist(*CRUISE) == "no wheel_states yet"
    rig.reports = True
    rig.run(0.1)
    assert rig.twist(*CRUISE) == ""


def test_wheel_that_does_not_follow_latches_a_stop_naming_the_wheel():
    rig = driving()
    stuck(rig)
    assert rig.core.latch.status.reason == "wheel 'front_right' does not follow its setpoint"
    since = next(i for i, c in enumerate(rig.setpoints) if i > 500 and ratio(c, (1, 1)) < 0.5)
    decelerates(rig.run(1.5), since)


def test_frozen_encoder_latches_a_stop_naming_the_wheel():
    rig = driving()
    rig.reports = False
    frozen, since = rig.position[0], len(rig.commands)
    for _ in range(round(2.0 / DT)):
        position = rig.position.copy()
        position[0] = frozen
        rig.core.update_wheels(rig.now + DT, rig.now + DT, position, rig.speed)
        rig.twist(*CRUISE)
        rig.tick()
        since += rig.core.latch.released
    assert rig.core.latch.status.reason.startswith("wheel 'front_left': position and velocity")
    decelerates(rig, since)


@pytest.mark.parametrize("back", [0.2, 10.0, 900.0])
def test_backward_time_jump_stops_and_discards_earlier_inputs(back):
    rig = following(seconds=9.0)
    rig.twist(*CRUISE)
    since = len(rig.commands) + 1
    rig.now -= back
    rig.reports = False
    rig.tick()  # no report with the new time yet
    rig.reports = True
    decelerates(rig.run(2.0), since)
    assert rig.core.latch.released
    assert rig.twist(*CRUISE) == ""  # without waiting until the old time is reached again
    rig.run(0.2, lambda: rig.twist(*CRUISE))
    assert rig.core.setpoint.any()


@pytest.mark.parametrize("source", [Source.MPC, Source.PATH])
@pytest.mark.parametrize("way", LATCHED)
def test_stop_ends_a_preview_permanently(source, way):
    rig = following(source)
    since = len(rig.commands)
    LATCHED[way](rig)
    decelerates(rig.run(1.0), since)
    rig.core.latch.set_emergency(False)
    rig.core.reset(rig.now)
    rig.run(1.0)  # the preview has not ended yet
    assert rig.still


def test_preview_that_ends_in_motion_ramps_down_at_once():
    rig = following(seconds=3.5)
    while rig.core.arbiter.active is not None:
        rig.tick()
    assert rig.now == pytest.approx(1000.1 + 3.5, abs=2 * DT)
    decelerates(rig.run(1.5), len(rig.commands) - 1)
    assert rig.core.latch.released


def test_preview_whose_sender_falls_silent_ramps_down_before_its_end():
    rig = Rig(changes={"timeouts.preview": 0.2}).run(0.1)
    preview = rig.line((0.4, 0.2, 0.3), 5.0)
    rig.run(2.0, lambda: rig.core.set_preview(Source.MPC, preview, rig.now))
    assert rig.core.arbiter.active is Source.MPC
    last = rig.now
    while rig.core.arbiter.active is not None:
        rig.tick()
    assert 0.2 - 4 * DT <= rig.now - last <= 0.2 + 2 * DT
    decelerates(rig.run(1.5), len(rig.commands) - 1)
    assert rig.core.latch.released


def test_setting_the_pose_cancels_a_preview():
    rig = following()
    since = len(rig.commands)
    rig.core.set_pose((5.0, 5.0, 1.0), np.eye(3))
    decelerates(rig.run(1.0), since)
    assert rig.core.odometry.pose[0] == pytest.approx(5.0, abs=0.5)
    rig.run(0.5)
    assert rig.still


def test_setting_the_pose_does_not_interrupt_cmd_vel():
    rig = driving()
    rig.core.set_pose((5.0, 5.0, 1.0))
    rig.run(0.1)
    np.testing.assert_allclose(rig.core.setpoint, CRUISE)


# ---- reset ------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", LATCHED)
def test_reset_starts_no_motion_while_a_stream_continues(way):
    rig = driving()
    LATCHED[way](rig)
    rig.run(1.5, lambda: rig.twist(*CRUISE))
    rig.core.latch.set_emergency(False)
    rig.core.reset(rig.now)
    rig.run(3.0, lambda: rig.twist(*CRUISE))
    assert rig.still
    rig.run(0.02, lambda: rig.twist(0, 0, 0))  # neutral
    rig.run(0.2, lambda: rig.twist(*CRUISE))
    assert rig.core.setpoint.any()


def test_reset_starts_no_motion_from_an_old_setpoint():
    rig = driving()
    rig.core.latch.stop("button")
    rig.run(0.45)  # cmd_vel would still be fresh, as would the preview below
    rig.core.set_preview(Source.PATH, rig.line((0.3, 0, 0), 9.0), rig.now)
    rig.run(0.2)
    rig.core.reset(rig.now)
    rig.run(2.0)
    assert rig.still


def test_stop_and_reset_within_one_tick_discard_earlier_setpoints():
    rig = Rig().run(0.1)
    rig.twist(*CRUISE)
    rig.core.set_preview(Source.PATH, rig.line((0.3, 0, 0), 9.0), rig.now)
    rig.core.latch.stop("button")
    rig.core.reset(rig.now)
    rig.run(1.0)
    assert all(not twist.any() for twist in rig.setpoints)


def test_start_after_a_stop_during_acceleration_is_smooth():
    rig = Rig().run(0.1)
    rig.run(0.4, lambda: rig.twist(1.0, 0, 0))
    rig.core.latch.stop("button")
    rig.run(1.5)
    rig.core.reset(rig.now)
    rig.twist(1.0, 0, 0)
    rig.tick()
    assert rig.core.setpoint[0] == pytest.approx(8.0 * DT * DT)


def test_reset_is_refused_in_motion_and_while_emergency_stop_is_true():
    rig = driving()
    rig.core.latch.set_emergency(True)
    rig.tick()
    with pytest.raises(ResetRefusedError, match="emergency_stop is true"):
        rig.core.reset(rig.now)
    rig.core.latch.set_emergency(False)
    with pytest.raises(ResetRefusedError, match="still moving"):
        rig.core.reset(rig.now)
    assert not rig.core.latch.released
    rig.run(1.0)
    rig.core.reset(rig.now)
    assert rig.core.latch.released


# ---- arbitration ------------------------------------------------------------------------------


def test_cmd_vel_takes_over_and_the_path_does_not_resume():
    rig = following(seconds=9.0)
    before = rig.core.setpoint
    rig.run(0.5, lambda: rig.twist(0, 0.2, 0))
    assert rig.core.arbiter.active is Source.CMD_VEL
    step = np.diff([before, *rig.setpoints[-100:]], axis=0)
    assert max(ratio(row, rig.core.parameters.limits.deceleration) for row in step) <= DT * SLACK
    rig.run(3.0)
    assert rig.still
    assert rig.core.arbiter.active is None


def test_path_received_just_after_cmd_vel_never_starts_by_itself():
    rig = Rig().run(0.1)
    rig.twist(0.3, 0, 0)
    rig.core.set_preview(Source.PATH, rig.line((0, 0.3, 0), 9.0), rig.now)
    rig.run(3.0)
    assert rig.still


# ---- invalid input ----------------------------------------------------------------------------

BAD_TWISTS = [
    [NAN, 0, 0],
    [0, INF, 0],
    [0, 0, -INF],
    [1e300, 0, 0],
    [0.1, 0.2],
    [0.1] * 4,
    [],
]
GOOD_PREVIEW = {"poses": np.zeros((2, 3)), "velocities": np.zeros((2, 3))}


def bad_inputs(rig):
    """Return calls that must raise InputError, by name."""
    core, now, n = rig.core, rig.now, rig.count
    ok = np.ones(n)
    calls = {f"twist {bad}": lambda bad=bad: rig.twist(*bad) for bad in BAD_TWISTS}
    calls |= {
        "twist of shape (1, 3)": lambda: core.set_twist(np.ones((1, 3)), now),
        "stale twist": lambda: rig.twist(0.9, 0, 0, age=0.51),
        "volts not finite": lambda: core.set_voltages(np.full(n, NAN), now),
        "volts infinite": lambda: core.set_voltages(np.full(n, INF), now),
        "volts of another size": lambda: core.set_voltages(np.ones(n + 1), now),
        "stale volts": lambda: core.set_voltages(ok, now, 0.11),
        "preview that is over": lambda: core.set_preview(
            Source.MPC, Preview(np.array([now - 3, now - 2]), **GOOD_PREVIEW), now
        ),
        "preview that begins late": lambda: core.set_preview(
            Source.MPC, Preview(np.array([now + 1.1, now + 2]), **GOOD_PREVIEW), now
        ),
        "wheels not finite": lambda: core.update_wheels(now + 1e-3, now, ok * NAN, ok),
        "wheels huge": lambda: core.update_wheels(now + 1e-3, now, ok * 1e300, ok),
        "wheel speeds infinite": lambda: core.update_wheels(now + 1e-3, now, None, ok * INF),
        "wheels of another size": lambda: core.update_wheels(
            now + 1e-3, now, np.ones(n + 1), None
        ),
        "wheels without content": lambda: core.update_wheels(now + 1e-3, now, None, None),
        "wheels out of order": lambda: core.update_wheels(core.feedback.time - 1, now, ok, ok),
        "wheels twice": lambda: core.update_wheels(core.feedback.time, now, ok, ok),
        "pose not finite": lambda: core.set_pose((NAN, 0, 0)),
        "covariance not finite": lambda: core.set_pose((0, 0, 0), np.full((3, 3), INF)),
    }
    return calls


@pytest.mark.parametrize("name", bad_inputs(Rig()))
def test_invalid_input_raises_and_leaves_all_outputs_unchanged(name):
    clean, spoiled = Rig(), Rig()
    for rig in (clean, spoiled):
        rig.cruise(*CRUISE, seconds=0.5)
        rig.core.set_preview(Source.PATH, rig.line((0.1, 0, 0), 5.0), rig.now)

    def spoil():
        with pytest.raises(InputError):
            bad_inputs(spoiled)[name]()

    clean.run(2.0)  # cmd_vel becomes stale after 0.5 s in both, whatever else is received
    spoiled.run(2.0, spoil)
    assert clean.trace() == spoiled.trace()
    assert clean.still
    assert clean.core.arbiter.active is spoiled.core.arbiter.active


@pytest.mark.parametrize("name", [n for n in bad_inputs(Rig()) if n.startswith("wheel")])
def test_invalid_wheel_states_do_not_count_as_reports(name):
    rig = driving()
    rig.reports = False

    def spoil():
        rig.twist(*CRUISE)
        with pytest.raises(InputError):
            bad_inputs(rig)[name]()

    rig.run(1.5, spoil)
    assert "wheel_states silent" in rig.core.latch.status.reason
    assert rig.still


def test_delayed_twist_is_fresh_for_the_rest_of_its_timeout():
    rig = Rig().run(0.1)
    rig.twist(*CRUISE, age=0.3)
    rig.run(0.19)
    assert rig.core.arbiter.active is Source.CMD_VEL
    rig.run(0.03)
    assert rig.core.arbiter.active is None


# ---- previews ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("robot", "source"), combinations(ALL, [Source.MPC, Source.PATH]))
def test_preview_is_followed_and_its_end_pose_kept(robot, source):
    rig = Rig(robot).run(0.1)
    assert rig.core.set_preview(source, rig.move((1.0, -0.6, 1.2), 5.0), rig.now) == ""
    worst = 0.0
    for _ in range(round(5.0 / DT)):
        rig.tick()
        assert rig.core.arbiter.active is source
        worst = max(worst, float(abs(rig.core.tracking_error).max()))
    assert worst < 5e-3
    rig.run(0.19)
    assert rig.core.arbiter.active is source
    rig.run(0.5)
    assert rig.core.arbiter.active is None
    np.testing.assert_allclose(rig.core.odometry.pose, [1.0, -0.6, 1.2], atol=1e-3)
    assert rig.still


def test_robot_beside_its_path_converges_to_the_path():
    rig = Rig().run(0.1)
    rig.core.set_preview(Source.PATH, rig.move((0.8, 0.3, 0.4), 6.0, offset=0.3), rig.now)
    rig.run(1.0)
    far = np.linalg.norm(rig.core.tracking_error)
    rig.run(5.1)
    assert far > 0.02
    assert np.linalg.norm(rig.core.tracking_error) < 1e-3
    np.testing.assert_allclose(rig.core.odometry.pose, [1.1, 0.3, 0.4], atol=2e-3)


def test_curve_is_followed_with_its_heading():
    rig = Rig().run(0.1)
    t = np.linspace(0, 8, 161)
    w = 0.6 * (1 - np.cos(np.minimum(t, 2) * math.pi / 2)) / 2  # reaches its speed in 2 s
    angle = np.concatenate([[0], np.cumsum((w[1:] + w[:-1]) / 2 * np.diff(t))])
    poses = np.column_stack([np.sin(angle), 1 - np.cos(angle), angle])
    velocity = np.column_stack([np.cos(angle) * w, np.sin(angle) * w, w])
    wrapped = poses.copy()
    wrapped[:, 2] = np.arctan2(np.sin(angle), np.cos(angle))
    rig.core.set_preview(Source.PATH, Preview(rig.now + t, wrapped, velocity), rig.now)
    rig.run(7.9)
    assert abs(rig.core.tracking_error).max() < 0.01
    assert rig.core.odometry.pose[2] > math.pi
    np.testing.assert_allclose(rig.core.setpoint, [0.6, 0, 0.6], atol=0.02)
    # At constant speed the feed-forward is only the centripetal force and friction.
    cascade, twist = rig.core.cascade, rig.core.setpoint
    expected = cascade.dynamics.platform_torque(twist, np.zeros(3))
    expected = expected + cascade.dynamics.friction_torque(twist, cascade.kinematics.J @ twist)
    assert abs(cascade.dynamics.platform_torque(twist, np.zeros(3))).max() > 1.0
    np.testing.assert_allclose(rig.commands[-1].effort, expected, atol=0.2)


def test_delayed_wheel_states_cause_no_following_error():
    rig = Rig().run(0.1)
    rig.reports, past = False, []
    preview = rig.move((1.5, 0.5, 0.0), 5.0)
    rig.core.set_preview(Source.PATH, preview, rig.now)
    for _ in range(round(5.0 / DT)):
        past.append((rig.now + DT, rig.position, rig.speed))
        if len(past) > 6:
            time, position, speed = past[-6]
            rig.core.update_wheels(time, rig.now + DT, position, speed)
        true = rig.core.cascade.kinematics.J_pinv @ rig.position
        reference = preview.sample(rig.now).pose
        rig.tick()
        assert abs(true - reference).max() < 5e-3  # the robot moves 14 mm in 25 ms


def test_previews_that_replace_each_other_give_one_continuous_motion():
    one, many = Rig().run(0.1), Rig().run(0.1)
    whole = one.move((1.0, 0.5, 0.7), 5.0)
    one.core.set_preview(Source.PATH, whole, one.now)
    one.run(5.0)

    def stream():
        times = many.now + np.arange(0, 0.6, 0.05)
        points = [whole.sample(t) for t in times]
        part = Preview(
            times,
            *(
                np.array([getattr(p, key) for p in points])
                for key in ("pose", "velocity", "acceleration")
            ),
        )
        assert many.core.set_preview(Source.PATH, part, many.now) == ""

    many.run(5.0, stream)
    difference = np.array(one.poses) - np.array(many.poses)
    assert abs(difference).max() < 2e-3


@pytest.mark.parametrize("ticks_late", [1, 6])
def test_previews_from_now_with_delayed_feedback_cause_no_lead(ticks_late):
    """The pose is older than the preview and is extrapolated to the preview's start."""
    rig, past = Rig().run(0.1), []
    whole = rig.move((1.5, 0.5, 0.0), 5.0)
    rig.reports = False
    for _ in range(round(5.0 / DT)):
        past.append((rig.now, rig.position, rig.speed))
        time, position, speed = past[max(len(past) - 1 - ticks_late, 0)]
        if time > rig.core.feedback.time:
            rig.core.update_wheels(time, rig.now + DT, position, speed)
        times = rig.now + DT + np.arange(0, 0.3, 0.05)
        points = [whole.sample(t) for t in times]
        arrays = (
            np.array([getattr(p, key) for p in points])
            for key in ("pose", "velocity", "acceleration")
        )
        assert rig.core.set_preview(Source.PATH, Preview(times, *arrays), rig.now + DT) == ""
        true = rig.core.cascade.kinematics.J_pinv @ rig.position
        assert abs(true - whole.sample(rig.now).pose).max() < 1.5e-3
        rig.tick()


def test_robot_too_far_from_its_path_is_not_driven():
    rig = Rig().run(0.1)
    rig.core.set_preview(Source.PATH, rig.move((1.0, 0, 0), 5.0, offset=0.6), rig.now)
    rig.tick()
    assert "path cancelled: following error 0.600 m" in rig.core.cancelled
    rig.run(6.0)
    assert all(not twist.any() for twist in rig.setpoints)
    assert rig.core.cancelled == ""


def test_preview_in_the_future_waits_at_its_first_point():
    rig = Rig().run(0.1)
    late = rig.line((0.3, 0, 0), 2.0, start=1.0)
    rig.core.set_preview(Source.PATH, late, rig.now)
    rig.run(0.9)
    assert rig.core.arbiter.active is Source.PATH
    np.testing.assert_allclose(rig.core.odometry.pose, 0, atol=1e-9)
    rig.run(0.5)
    assert rig.core.setpoint[0] > 0.2


# ---- voltages ---------------------------------------------------------------------------------


def volts(rig, level):
    return lambda: rig.core.set_voltages(np.full(rig.count, level), rig.now)


def test_voltages_are_passed_on_within_the_amplifier_limits():
    rig = Rig().run(0.1)
    rig.run(0.5, volts(rig, 10.0))
    last = rig.commands[-1]
    assert last.mode is DriveMode.VOLTAGE
    assert last.velocity is None
    np.testing.assert_array_equal(last.effort, 10.0)
    assert rig.core.arbiter.active is Source.MPC
    rig.core.set_voltages(np.array([100.0, -100, 48, 1]), rig.now)
    np.testing.assert_array_equal(rig.core.tick(rig.now).effort, [48, -48, 48, 1])


def test_stale_voltages_cause_a_velocity_ramp_from_the_measured_speed():
    rig = Rig().run(0.1)
    rig.run(0.5, volts(rig, 10.0))
    speed = 10.0 / (25 * 0.11)
    np.testing.assert_allclose(rig.core.setpoint, [speed * 0.127, 0, 0], atol=1e-9)
    while rig.commands[-1].mode is DriveMode.VOLTAGE:
        rig.tick()
    since = len(rig.commands) - 1
    assert since * DT == pytest.approx(0.7, abs=0.03)
    decelerates(rig.run(1.5), since)
    assert rig.core.latch.released


@pytest.mark.parametrize("way", LATCHED)
def test_stop_ends_voltages_at_once(way):
    rig = Rig().run(0.1)
    rig.run(0.5, volts(rig, 10.0))
    since = len(rig.commands)
    LATCHED[way](rig)
    decelerates(rig.run(1.0, volts(rig, 10.0)), since)


def test_voltages_are_rejected_where_the_drives_have_no_voltage_mode():
    rig = Rig(changes={"drive.offered": ["velocity"]}).run(0.1)
    with pytest.raises(InputError, match="no voltage mode"):
        rig.core.set_voltages(np.ones(4), rig.now)
    rig.run(0.1)
    assert rig.still


@pytest.mark.parametrize(
    ("limit", "speed"),
    [({"motor.max_speed": 6.0}, 6.0), ({"limits.linear_velocity": 0.5}, 0.5 / 0.127)],
)
def test_voltages_that_overspeed_a_wheel_or_the_platform_are_cancelled(limit, speed):
    rig = Rig(changes=limit).run(0.1)
    rig.run(0.2, volts(rig, speed * 1.08 * 25 * 0.11))
    assert rig.core.arbiter.active is Source.MPC
    volts(rig, speed * 1.12 * 25 * 0.11)()
    rig.tick()
    rig.tick()
    assert "mpc cancelled" in rig.core.cancelled and "speed limit" in rig.core.cancelled
    since = len(rig.commands) - 1
    assert rig.commands[-1].mode is DriveMode.VELOCITY
    rig.run(2.0, volts(rig, 24.0))
    assert rig.still
    assert all(c.mode is DriveMode.VELOCITY for c in rig.commands[since:])


def test_cmd_vel_takes_over_from_fast_voltages_without_a_jump():
    rig = Rig().run(0.1)
    rig.run(0.5, volts(rig, 23.0))  # 1.06 m/s: voltages may exceed the limit slightly
    before = rig.core.setpoint
    assert before[0] > 1.05
    since = len(rig.setpoints)
    rig.run(1.5, lambda: rig.twist(0.5, 0, 0))
    step = np.diff([before, *rig.setpoints[since:]], axis=0)
    assert max(ratio(row, rig.core.parameters.limits.deceleration) for row in step) <= DT * SLACK
    np.testing.assert_array_equal(rig.core.setpoint, [0.5, 0, 0])


def test_preview_takes_over_from_voltages_of_the_same_planner():
    rig = Rig().run(0.1)
    rig.run(0.3, volts(rig, 5.0))
    rig.core.set_preview(Source.MPC, rig.line((0.3, 0, 0), 1.0), rig.now)
    assert rig.tick().mode is DriveMode.VELOCITY


# ---- coupling ---------------------------------------------------------------------------------


def uneven(rig):
    """Give the wheels unequal gains, as described in CCTA 2017, section V.C."""
    gains = np.linspace(0.97, 1.03, rig.count)[np.random.default_rng(2).permutation(rig.count)]
    ideal = rig.drive
    rig.drive = lambda command: gains * ideal(command)
    return rig


@pytest.mark.parametrize(
    "robot", representative(["omniman", "mecanum6", "skewed4", "mecanum8"], every=2)
)
def test_coupling_controller_bounds_the_error_of_uneven_drives(robot):
    errors = []
    for gain in (0.0, 2.0):
        rig = uneven(Rig(robot, {"coupling.k_epsilon": gain}))
        rig.cruise(0.5, 0.2, 0.1, seconds=12.0)
        errors.append(abs(rig.core.cascade.coupling.error).max())
    assert errors[1] < 0.12 * errors[0]


def test_integrated_coupling_error_outlives_rest_and_pose_until_odometry_is_reset():
    rig = uneven(Rig()).cruise(*CRUISE)
    rig.run(2.0)
    total = rig.core.odometry.coupling_error
    assert total.any()
    rig.core.set_pose((1.0, 0.0, 0.0))
    np.testing.assert_array_equal(rig.core.odometry.coupling_error, total)
    rig.core.reset_odometry()
    assert rig.core.odometry.pose == (0.0, 0.0, 0.0)
    assert not rig.core.odometry.coupling_error.any()


def test_controlled_error_is_the_integrated_one_without_resets():
    rig = uneven(Rig("omniman", {"coupling.reset_at_rest": False})).cruise(*CRUISE)
    rig.run(2.0)
    controlled = rig.core.cascade.coupling.error
    assert controlled.any()
    np.testing.assert_allclose(controlled, rig.core.odometry.coupling_error)


def test_wheels_that_roll_as_the_lag_of_their_rollers_has_it_have_no_controlled_error():
    rig = Rig("omniman", {"coupling.roller_lag": 0.01}).cruise(0.3, 0.0, 0.5, seconds=3.0)
    total = rig.core.odometry.coupling_error
    assert abs(total[0]) > 0.05
    np.testing.assert_allclose(rig.core.cascade.coupling.error, 0.0, atol=0.03 * abs(total[0]))


# ---- configuration ----------------------------------------------------------------------------


def test_new_limits_apply_in_motion_without_a_jump():
    rig = Rig().cruise(1.0, 0, 0)
    changed = parameters("omniman", {"limits.linear_velocity": 0.4, "position.k_xy": 1.0})
    rig.core.configure(changed)
    since = len(rig.setpoints)
    rig.cruise(1.0, 0, 0, seconds=1.5)
    step = np.diff(rig.setpoints[since - 1 :], axis=0)
    assert (
        max(ratio(row, changed.limits.velocity) for row in rig.setpoints[since + 150 :]) <= SLACK
    )
    assert max(ratio(row, changed.limits.deceleration) for row in step) <= DT * SLACK


def test_parameters_of_an_impossible_platform_change_nothing():
    rig = driving()
    other = build(
        PlatformParameters,
        flatten(parameters("omniman")) | {"wheels.roller_angle": [1.5708] * 4},
    )
    with pytest.raises(ValueError, match="90 degrees"):
        rig.core.configure(other)
    assert rig.core.parameters == parameters("omniman")
    before = rig.core.setpoint
    rig.run(0.1)
    np.testing.assert_allclose(rig.core.setpoint, before)


# ---- every parameter has an effect ------------------------------------------------------------

ELSEWHERE = {
    "motor.inductance": "the simulated drives",
    "motor.encoder_counts": "the drives",
    "body.length": "planner and viewer",
    "body.width": "planner and viewer",
    "body.outline_x": "planner, monitor and viewer",
    "body.outline_y": "planner, monitor and viewer",
    "friction.mu": "the simulated drives and the planner",
}
CHANGED = {
    "wheels.names": ("a", "b", "c", "d"),
    "drive.mode": "torque",
    "drive.offered": ("velocity",),
    "drive.following_error": 10.0,
    "drive.dead_wheel": "drive_on",
    "drive.dead": ("rear_left",),
    "health.asked_torque": 0.2,
    "health.silent_torque": 0.008,
    "odometry.encoder_span": math.tau,
    "motor.max_speed": 5.0,
    "motor.max_voltage": 12.0,
    "motor.gear_efficiency": 0.6,
    "timeouts.wheel_states": 0.03,
    "timeouts.cancelled": 30.0,
    "position.max_linear_error": 0.2,
    "position.max_angular_error": 0.2,
    "coupling.authority": 0.001,
    "odometry.slip_threshold": 0.001,
}


def changed_value(spec, value):
    if spec.name in CHANGED:
        return CHANGED[spec.name]
    if spec.kind is bool:
        return not value
    if spec.kind is tuple:
        return tuple(1.1 * v + 0.01 * (i + 1) for i, v in enumerate(value))
    return 1.3 * value + 0.02


def base_of(name):
    """Return the other settings that a parameter needs in order to have an effect."""
    if name.startswith(("motor.", "wheel.")):
        return {"drive.mode": "voltage" if name.startswith("motor.res") else "torque"}
    if name.startswith("health.blocked"):
        return {"held.stop": False}
    return {"drive.dead_wheel": "drive_on"} if name == "drive.dead_limits" else {}


#: Parameters that need an inertial sensor or a turn that is held: test_imu, test_held_robot
APART = ("imu.", "held.torque", "held.yaw_rate", "held.speed")


def tour(changes):
    """Exercise every input once and return all resulting outputs."""
    rig, told = uneven(Rig("omniman", changes)), []

    def note(text):
        told.append((rig.now, text))

    def attempt(call):
        try:
            note(call())
        except (InputError, ResetRefusedError) as error:
            note(str(error))

    def watch(seconds, feed=None):
        for i in range(round(seconds / 0.01)):
            if feed is not None and i % 2 == 0:
                feed()
            rig.tick(0.01)
            odometry = rig.core.odometry
            note(
                (
                    rig.core.arbiter.active,
                    rig.core.cancelled,
                    rig.core.latch.status,
                    odometry.slipping,
                    odometry.covariance.tobytes(),
                )
            )

    watch(0.1)
    for twist in ((0.5, 0.3, 0.2), (9, 0, 0), (0, 0, 9)):
        watch(1.5, lambda twist=twist: attempt(lambda: rig.twist(*twist)))
    watch(1.2)
    for offset, goal in ((0.3, (0.3, 0.2, 0.4)), (0.0, (0.1, 0.1, 1.2)), (0.0, (0.0, 0.0, 0.0))):
        preview = rig.move(goal, 1.0 if goal[2] > 1 else 2.5, offset)
        attempt(lambda preview=preview: rig.core.set_preview(Source.PATH, preview, rig.now))
        watch(3.5)
    rig.core.set_pose((0.0, 0.0, 0.5), np.zeros((3, 3)))
    turned = Preview(rig.now + np.array([0.0, 2.0]), np.zeros((2, 3)), np.zeros((2, 3)))
    attempt(lambda: rig.core.set_preview(Source.PATH, turned, rig.now))
    watch(2.5)
    watch(0.3, lambda: attempt(volts(rig, 15.0)))
    watch(1.5)
    watch(1.0, lambda: attempt(lambda: rig.twist(0.4, 0.2, 0.2)))
    rig.position = rig.position + 200 * math.tau  # counters that restart
    watch(0.1)
    rig.reports = False
    watch(0.06, lambda: attempt(lambda: rig.twist(0.4, 0.2, 0.2)))
    rig.reports = True
    watch(0.5, lambda: attempt(lambda: rig.twist(0.4, 0.2, 0.2)))
    smooth = rig.drive
    begin = rig.now
    fading = np.array([0.0, 0.0, 0.0, 1.0])
    rig.effort = lambda: rig.torques() * np.exp(-fading * (rig.now - begin) / 0.2)
    watch(2.0, lambda: attempt(lambda: rig.twist(0.9, 0.0, 0.0)))
    rig.core.latch.stop("button")
    watch(1.5)
    rig.core.reset(rig.now)
    rig.effort = lambda: None
    watch(1.2)

    def lame(command):
        speeds = np.array(smooth(command))
        speeds[2] = 0.0
        return speeds

    rig.drive = lame
    watch(1.0, lambda: attempt(lambda: rig.twist(0.4, 0.2, 0.2)))
    rig.drive = smooth
    watch(1.5)
    rig.core.reset(rig.now)
    watch(1.2)
    rig.drive, pushed = lame, np.array([20.0, 20.0, 40.0, 20.0])
    rig.effort = lambda: pushed * min(abs(rig.core.setpoint[0]) / 0.3, 1.0)
    watch(1.0, lambda: attempt(lambda: rig.twist(0.4, 0.0, 0.0)))
    return rig.trace(), told


@pytest.fixture(scope="module")
def tours():
    """Return a cache of tours without the change, by their other settings."""
    known = {}

    def get(base):
        key = tuple(base.items())
        if key not in known:
            known[key] = tour(base)
        return known[key]

    return get


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "spec",
    [s for s in specs(PlatformParameters) if not s.name.startswith((*ELSEWHERE, *APART))],
    ids=lambda s: s.name,
)
def test_each_parameter_changes_the_outputs(spec, tours):
    base = base_of(spec.name)
    value = flatten(parameters("omniman", base))[spec.name]
    other = changed_value(spec, value)
    assert other != value
    assert tour({**base, spec.name: other}) != tours(base)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ELSEWHERE)
def test_parameters_of_other_nodes_do_not_change_the_outputs(name, tours):
    spec = next(s for s in specs(PlatformParameters) if s.name == name)
    value = flatten(parameters("omniman"))[name]
    other = value + 1 if spec.kind is int else 1.3 * value + 0.02
    assert tour({name: other}) == tours({})


# ---- replay -----------------------------------------------------------------------------------


SEEDS = [0, 1, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in range(2, 6))]


def random_drive(seed):
    """Apply a minute of random valid and invalid inputs in random order."""
    rng = np.random.default_rng(seed)
    rig = uneven(Rig(ALL[seed % len(ALL)]))
    rig.run(0.1)
    for _ in range(150):
        what, scale = rng.integers(13), rng.choice([0.3, 1.0, NAN, 1e3], p=[0.5, 0.4, 0.05, 0.05])
        try:
            if what < 5:
                rig.twist(*(scale * rng.uniform(-1, 1, 3)))
            elif what < 7:
                source = (Source.MPC, Source.PATH)[rng.integers(2)]
                goal = tuple(0.5 * rng.uniform(-1, 1, 3))
                rig.core.set_preview(source, rig.move(goal, rng.uniform(0.5, 2)), rig.now)
            elif what == 7:
                level = scale * rng.uniform(-5, 5, rig.count)
                rig.core.set_voltages(level, rig.now, rng.uniform(-0.01, 0.15))
            elif what == 8:
                rig.core.latch.stop("button")
            elif what == 9:
                rig.core.latch.set_emergency(bool(rng.integers(2)))
            elif what == 10:
                rig.core.latch.set_peer("arm", bool(rng.integers(2)))
            else:
                rig.core.latch.set_emergency(False)
                rig.core.latch.set_peer("arm", False)
                rig.core.reset(rig.now)
        except (InputError, ResetRefusedError):
            pass
        rig.reports = rng.uniform() > 0.03
        for _ in range(rng.integers(1, 60)):
            rig.tick(rng.choice([DT, 0.004, 0.011]))
    return rig


@pytest.mark.parametrize("seed", SEEDS)
def test_equal_inputs_give_bit_identical_outputs(seed):
    first, second = random_drive(seed), random_drive(seed)
    assert first.trace() == second.trace()
    assert any(twist.any() for twist in first.setpoints)


@pytest.mark.parametrize("seed", SEEDS)
def test_commands_are_always_finite_and_within_the_wheel_speed_limit(seed):
    rig = random_drive(seed)
    motor = rig.core.parameters.robot.motor
    for command in rig.commands:
        assert finite(command)
        if command.velocity is not None:
            assert abs(command.velocity).max() <= motor.max_speed * SLACK
        elif command.mode is DriveMode.VOLTAGE:
            assert abs(command.effort).max() <= motor.max_voltage * SLACK
    rig.core.latch.stop("the end")
    rig.reports = True
    rig.run(3.0)
    assert rig.still


def test_two_controllers_share_no_state():
    alone = random_drive(1).trace()
    rig = random_drive(2)
    other = replace(rig.core.parameters)
    Rig(other).run(0.1)
    assert random_drive(1).trace() == alone
