"""Detection of wheel faults and the controller's reaction."""

import numpy as np
import pytest

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.control.wheel_health import PersistenceMonitor
from omniman_ros.core.arbiter import Source
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.stop import ResetRefusedError
from test.control.rig import DT, Rig
from test.robots import ALL, kinematics, parameters

ON = {"drive.dead_wheel": "drive_on"}
CRUISE = (0.3, 0.02, 0.03)


def driving(robot="omniman", changes=None):
    """Return a moving rig whose drives report the requested torques."""
    rig = Rig(robot, changes)
    rig.run(0.1)
    rig.effort = rig.torques
    return rig.cruise(*CRUISE)


def kill(rig, *wheels, seconds=2.5):
    """Remove the torque of some wheels, which are then dragged along, and continue to drive."""
    rig.effort = lambda: rig.torques(*wheels)
    return rig.run(seconds, lambda: rig.twist(*CRUISE))


# ---- lasting watch ----------------------------------------------------------------------------


def test_fault_must_persist_to_be_reported():
    watch = PersistenceMonitor(3)
    late = np.array([False, True, False])
    found = [watch.update(late, 0.45, 0.1) for _ in range(6)]
    assert found[:5] == [None] * 5
    assert found[5] == 1
    assert watch.update(late, 0.45, 0.1) is None  # the count restarts
    assert PersistenceMonitor(3).update(late, 0.45, 1.0) is None, (
        "it is unknown whether the fault lasted all that time"
    )


def test_one_good_sample_clears_the_count():
    watch = PersistenceMonitor(2)
    late = np.array([True, False])
    for good in (~late, np.zeros(2, dtype=bool)):
        for _ in range(20):
            assert watch.update(late, 0.5, 0.2) is None
            assert watch.update(late, 0.5, 0.2) is None
            assert watch.update(good, 0.5, 0.2) is None


# ---- dead wheels ------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{}, ON], ids=["stop", "drive_on"])
def test_wheels_that_give_the_requested_torque_are_not_reported(changes):
    rig = driving(changes=changes).run(3.0, lambda: None)
    rig.cruise(-0.2, 0.3, -0.3).cruise(0.0, 0.0, 0.5)
    assert rig.core.latch.released
    assert (
        rig.core.wheel_health.dead,
        rig.core.wheel_health.idle,
        rig.core.wheel_health.notice,
    ) == ((), (), "")
    assert rig.core.wheel_health.torque_reported


def test_dead_wheel_stops_the_robot_naming_the_wheel():
    rig = kill(driving(), 2)
    assert rig.core.latch.status.reason == "wheel 'rear_left' is dead: no torque"
    assert [rig.core.wheel_health.state(i) for i in range(4)] == [
        "driving",
        "driving",
        "dead",
        "driving",
    ]
    assert rig.core.wheel_health.idle == ()
    assert rig.run(1.5).still


@pytest.mark.parametrize("robot", [name for name in ALL if name != "omni3"])
def test_robot_continues_without_a_jump_under_drive_on(robot):
    rig = driving(robot, ON)
    since = len(rig.setpoints)
    kill(rig, 1)
    assert rig.core.latch.released, rig.core.latch.status
    assert rig.core.wheel_health.idle == (1,)
    assert rig.core.wheel_health.state(1) == "idle"
    assert "dead: driving on without" in rig.core.wheel_health.notice
    steps = np.abs(np.diff(rig.setpoints[since - 1 :], axis=0))
    limits = rig.core.parameters.limits
    assert steps[:, :2].max() <= DT * max(limits.acceleration[0], limits.deceleration[0]) + 1e-9
    moved = np.abs(np.diff(rig.poses[since - 1 :], axis=0))
    assert moved.max() < 0.4 * DT
    command = rig.commands[-1]
    assert command.effort[1] == 0.0
    np.testing.assert_allclose(
        command.velocity[1], (rig.core.cascade.kinematics.J @ rig.core.setpoint)[1]
    )


def test_limits_without_a_wheel_are_lower_except_the_deceleration_of_stops():
    rig = kill(driving(changes=ON), 1)
    limits, known = rig.core.wheel_health.limits, rig.core.parameters.limits
    assert limits.velocity == tuple(0.5 * v for v in known.velocity)
    assert limits.acceleration == tuple(0.5 * a for a in known.acceleration)
    assert limits.deceleration == known.deceleration
    rig.cruise(5.0, 0.0, 0.0)
    assert rig.core.setpoint[0] == pytest.approx(0.5 * known.linear_velocity)


def test_odometry_and_coupling_exclude_the_dead_wheel():
    rig = kill(driving(changes=ON), 0)
    ideal = rig.drive

    def lagging(command):
        speeds = np.array(ideal(command))
        speeds[0] -= 1.0
        return speeds

    rig.drive = lagging
    rig.run(1.0, lambda: rig.twist(*CRUISE))
    np.testing.assert_allclose(rig.core.odometry.twist, CRUISE, atol=1e-9)
    assert not rig.core.cascade.coupling.error.any()


def test_wheels_die_one_by_one_until_the_others_do_not_determine_the_twist():
    rig = driving("mecanum6", ON)
    health = rig.core.wheel_health
    for dead in ((1,), (1, 4), (0, 1, 4)):
        kill(rig, *dead)
        assert rig.core.latch.released, rig.core.latch.status
        assert health.idle == rig.core.cascade.kinematics.idle == dead
        np.testing.assert_allclose(rig.core.odometry.twist, CRUISE, atol=1e-6)
    assert health.notice.startswith("wheels 'front_left', 'middle_left', 'middle_right' are dead")
    kill(rig, 0, 1, 3, 4)
    assert rig.core.latch.status.reason == (
        "wheel 'front_right' is dead: no torque; the others do not determine the twist well"
    )
    assert health.stopping
    assert health.idle == (0, 1, 4)
    assert health.summary.endswith("'middle_left', 'front_right', 'middle_right' are dead")
    assert rig.run(1.5).still


@pytest.mark.parametrize("dead", [(1, 4), (0, 1)])
def test_robot_drives_on_without_two_wheels_that_die_at_once(dead):
    rig = kill(driving("mecanum6", ON), *dead)
    assert rig.core.latch.released, rig.core.latch.status
    assert rig.core.wheel_health.dead == rig.core.wheel_health.idle == dead
    assert not rig.core.wheel_health.stopping


def test_two_dead_wheels_stop_the_robot_unless_it_may_drive_on():
    rig = kill(driving("mecanum6"), 1, 4)
    assert not rig.core.latch.released
    assert rig.core.wheel_health.stopping
    assert rig.run(1.5).still


def test_wheel_found_dead_adds_to_the_configured_one_and_leaves_with_a_reset():
    rig = kill(driving("mecanum6", ON | {"drive.dead": ("middle_left",)}), 1, 4)
    assert rig.core.wheel_health.idle == (1, 4)
    rig.run(2.5)
    rig.core.configure(parameters("mecanum6", ON))
    assert rig.core.wheel_health.idle == (4,), "the one that was named drives again"
    rig.core.configure(parameters("mecanum6", ON | {"drive.dead": ("middle_left",)}))
    rig.core.reset(rig.now)
    assert rig.core.wheel_health.idle == rig.core.cascade.kinematics.idle == (1,)


@pytest.mark.parametrize("mode", ["velocity", "torque", "voltage"])
def test_wheels_that_determine_the_twist_weakly_have_lower_limits_and_velocity_mode(mode):
    """Without the rear wheels, 0.258 of J's smallest singular value is left, of 0.5 for strong."""
    changes = {"drive.dead": ("rear_right", "rear_left"), "drive.mode": mode}
    rig = Rig("mecanum6", changes).run(0.1).cruise(0.2, 0.0, 0.0)
    health, known = rig.core.wheel_health, rig.core.parameters.limits
    assert health.weak
    assert health.limit_scale == pytest.approx(0.5 * 0.258 / 0.5, abs=1e-3)
    assert health.limits.velocity == tuple(health.limit_scale * v for v in known.velocity)
    assert health.limits.deceleration == known.deceleration
    assert rig.commands[-1].mode is DriveMode.VELOCITY
    assert (", in velocity mode" in health.notice) is (mode != "velocity")
    strong = Rig("mecanum6", changes | {"drive.dead": ("middle_left", "middle_right")})
    strong.run(0.1).cruise(0.2, 0.0, 0.0)
    assert not strong.core.wheel_health.weak
    assert strong.core.wheel_health.limit_scale == 0.5
    assert strong.commands[-1].mode is DriveMode(mode)


def test_three_wheel_robot_cannot_drive_on_without_a_wheel():
    rig = kill(driving("omni3", ON), 0)
    assert "the others do not determine the twist" in rig.core.latch.status.reason


def test_reset_clears_a_dead_wheel_and_detection_finds_the_wheel_again():
    rig = kill(driving(changes=ON), 3)
    with pytest.raises(ResetRefusedError):
        rig.core.reset(rig.now)
    assert rig.core.wheel_health.idle == (3,)
    rig.run(2.5)
    rig.core.reset(rig.now)
    assert rig.core.wheel_health.idle == rig.core.cascade.kinematics.idle == ()
    assert rig.core.wheel_health.limits == rig.core.parameters.limits
    kill(rig.run(1.5), 3, seconds=3.0)
    assert rig.core.wheel_health.idle == (3,)


def test_voltages_are_monitored_and_rejected_without_a_wheel():
    told = []
    rig = Rig("omniman", ON).run(0.1)
    torques = np.full(4, 3.0)
    rig.effort = lambda: torques
    emf = rig.core.parameters.robot.motor
    volts = np.full(4, 3.2 * emf.gear_ratio * emf.torque_constant)
    rig.drive = lambda command: np.full(4, 3.0 if command.velocity is None else 0.0)

    def feed():
        try:
            rig.core.set_voltages(volts, rig.now)
        except InputError as error:
            told.append(str(error))

    rig.run(0.5, feed)
    assert rig.core.arbiter.active is Source.MPC
    assert not told
    torques = np.array([0.0, 3.0, 3.0, 3.0])
    rig.run(1.5, feed)
    assert rig.core.wheel_health.idle == (0,)
    assert told[-1].endswith("computed for all wheels, but wheel 'front_left' is dead")
    assert rig.core.arbiter.active is None


# ---- configured dead wheels -------------------------------------------------------------------


def test_wheel_can_be_configured_as_dead():
    rig = Rig("omniman", {"drive.dead": ("rear_left",)}).run(0.1).cruise(*CRUISE)
    assert rig.core.setpoint == pytest.approx(CRUISE)
    assert (
        rig.core.wheel_health.notice
        == "wheel 'rear_left' is dead: driving on without, as drive.dead says"
    )
    assert rig.commands[-1].effort[2] == 0.0
    assert rig.core.cascade.kinematics.idle == (2,)


def test_dead_wheel_parameter_changes_only_at_rest():
    rig = Rig().run(0.1)
    rig.core.configure(parameters("omniman", {"drive.dead": ("rear_left",)}))
    assert rig.core.wheel_health.idle == rig.core.cascade.kinematics.idle == (2,)
    rig.cruise(*CRUISE)
    with pytest.raises(ParameterError, match="stop it first"):
        rig.core.configure(parameters("omniman"))
    rig.run(1.5)
    rig.core.configure(parameters("omniman"))
    assert rig.core.wheel_health.idle == rig.core.cascade.kinematics.idle == ()


@pytest.mark.parametrize(
    ("robot", "dead"),
    [("omniman", ("wheel",)), ("omniman", ("front_left", "rear_left")), ("omni3", ("rear",))],
)
def test_unknown_or_too_many_dead_wheels_are_rejected(robot, dead):
    with pytest.raises(ParameterError, match=r"drive.dead"):
        PlatformController(parameters(robot, {"drive.dead": dead}))


def test_dead_wheel_stays_dead_when_a_limit_changes():
    rig = kill(driving(changes=ON), 1)
    rig.core.configure(parameters("omniman", ON | {"drive.dead_limits": 0.25}))
    assert rig.core.cascade.kinematics.idle == (1,)
    assert (
        rig.core.wheel_health.limits.linear_velocity
        == 0.25 * rig.core.parameters.limits.velocity[0]
    )


# ---- missing torques, invalid torques, blocked wheels -----------------------------------------


def test_dead_wheel_detection_without_torques_is_reported_as_unavailable():
    rig = Rig("omniman", ON).run(0.1).cruise(*CRUISE)
    assert not rig.core.wheel_health.torque_reported
    assert rig.core.latch.released


def test_torques_of_wrong_size_are_invalid_input_and_cause_no_motion():
    rig = driving()
    pose = rig.core.odometry.pose
    with pytest.raises(InputError, match="efforts"):
        now = rig.now + DT
        rig.core.update_wheels(now, now, rig.position + 1.0, rig.speed, np.zeros(3))
    assert rig.core.odometry.pose == pose


@pytest.mark.parametrize("changes", [{}, ON], ids=["stop", "drive_on"])
def test_blocked_wheel_stops_the_robot_at_once_even_under_drive_on(changes):
    rig = driving(changes=changes)
    ideal = rig.drive

    def blocked(command):
        speeds = np.array(ideal(command))
        speeds[1] = 0.0
        return speeds

    rig.drive = blocked
    direction = np.sign(rig.core.cascade.reference[1])
    rig.effort = lambda: rig.torques() + np.array([0.0, 40.0 * direction, 0.0, 0.0])
    rig.run(0.4, lambda: rig.twist(*CRUISE))
    assert rig.core.latch.status.reason == "wheel 'front_right' is blocked: torque, but no speed"
    assert rig.core.wheel_health.idle == ()


def pushing_in_vain(rig, speed):
    """Drive forward from rest while the front right wheel stands at its full torque."""
    rig.run(2.0)
    ideal = rig.drive

    def blocked(command):
        speeds = np.array(ideal(command))
        speeds[1] = 0.0
        return speeds

    rig.effort = lambda: rig.torques() + np.array([0.0, 40.0, 0.0, 0.0])
    rig.drive = blocked
    return rig.cruise(speed, 0.0, 0.0)


def test_wheel_with_little_requested_torque_may_stand():
    """A wheel that starts slowly stands against friction and the differences of its neighbours."""
    rig = driving(changes={"held.stop": False})
    radius = rig.core.parameters.robot.wheels.radius[1]
    pushing_in_vain(rig, 0.4 * radius)
    assert rig.core.latch.released, rig.core.latch.status
    rig.cruise(0.8 * radius, 0.0, 0.0)
    assert "is blocked" in rig.core.latch.status.reason


def test_late_reports_do_not_make_a_wheel_blocked():
    """The wheel stood when the motion began; its later motion is unknown until reported."""
    rig = driving(changes={"held.stop": False})
    rig.run(2.0)  # at rest: cmd_vel is stale
    rig.effort = lambda: np.full(4, 40.0)
    ideal = rig.drive
    rig.drive = lambda command: np.zeros(4)
    rig.run(0.15, lambda: rig.twist(0.6, 0.0, 0.0))
    assert rig.core.cascade.reference[1] > 0.55
    rig.reports, rig.drive = False, ideal
    rig.run(0.19, lambda: rig.twist(0.6, 0.0, 0.0))
    rig.reports = True
    rig.run(0.3, lambda: rig.twist(0.6, 0.0, 0.0))
    assert rig.core.latch.released, rig.core.latch.status


# ---- models without a wheel -------------------------------------------------------------------


@pytest.mark.parametrize("robot", [name for name in ALL if name != "omni3"])
def test_models_without_a_wheel_equal_those_of_the_remaining_wheels(robot):
    whole = kinematics(robot)
    cascade = PlatformController(
        parameters(robot, {"drive.dead": parameters(robot).robot.wheels.names[:1]})
    ).cascade
    model, dynamics = cascade.kinematics, cascade.dynamics
    rest = list(range(1, whole.wheel_count))
    np.testing.assert_allclose(model.J_pinv[:, rest], np.linalg.pinv(whole.J[rest]), atol=1e-9)
    assert not model.J_pinv[:, 0].any() and not model.T[:, 0].any()
    np.testing.assert_allclose(model.T @ model.J, 0.0, atol=1e-9)
    assert np.linalg.matrix_rank(model.T) == whole.constraint_count - 1
    twist, rate = np.array([0.3, -0.2, 0.4]), np.array([0.2, 0.1, -0.3])
    full = PlatformController(parameters(robot)).cascade.dynamics
    wheels = whole.J @ twist
    for part, same in (
        (dynamics.platform_torque(twist, rate), full.platform_torque(twist, rate)),
        (dynamics.friction_torque(twist, wheels), full.friction_torque(twist, wheels)),
    ):
        assert part[0] == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(whole.J.T @ part, whole.J.T @ same, atol=1e-9)
    assert dynamics.torque_limit[0] == 0.0 < dynamics.torque_limit[1]


def test_remaining_capability_is_reported():
    model = kinematics("omniman")
    assert model.remaining_fraction(()) == pytest.approx(1.0)
    assert all(0.5 < model.remaining_fraction([k]) < 1.0 for k in range(4))
    assert model.remaining_fraction([0, 1]) == 0.0
    assert kinematics("mecanum8").remaining_fraction([3]) > 0.8
