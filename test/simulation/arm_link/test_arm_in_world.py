"""A UR controller whose joints are in the physics world, in lockstep."""

from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.simulation.ur.arm import CYCLE
from omniman_ros.simulation.ur.dynamics import ArmDynamics
from omniman_ros.simulation.ur.modes import Cb3RobotMode, Cb3RuntimeState, Cb3SafetyMode
from omniman_ros.simulation.world.scene import Scene, Table
from test.simulation.arm_link.world_rig import WorldRig
from test.simulation.world.support import EMPTY, ideal, rollers

STRETCHED = [0.0, 0.0, 0.0, -1.57, -1.57, 0.0]
RAISED = [0.0, -1.0, 0.0, -1.57, -1.57, 0.0]
TABLE = Scene(tables=(Table(name="table", x=1.2, y=0.0, length=0.8, width=1.6, height=0.35),))


def rig(posture=STRETCHED, scene=EMPTY, make=ideal, settle=0.2, **changes):
    controller = {key: changes.pop(key) for key in ("payload",) if key in changes}
    result = WorldRig(make("omniman", scene, world__posture=posture, **changes), **controller)
    result.run(settle)
    result.track.clear()
    result.loads.clear()
    return result


def safety(rig):
    return rig.controller.modes.safety


def test_the_joints_follow_later_by_the_reference_the_cycle_and_the_link():
    """10 ms of the joints, half a cycle of sampling, and two cycles of the link."""
    r = rig(RAISED)
    targets = []
    r.play(lambda host, k: k or host.speedj((0.5, 0, 0, 0, 0, 0), 5.0, 10.0))
    for _ in range(60):
        r.cycle()
        targets.append(r.controller.target.q[0])
    lag = (targets[-2] - r.track[-1][0][0]) / 0.5 + CYCLE
    assert lag == pytest.approx(0.010 + 0.5 * CYCLE + 2 * CYCLE, abs=0.001)


def test_the_currents_show_gravity_and_acceleration():
    r = rig()
    c = r.controller
    np.testing.assert_allclose(
        c.output("actual_current"), c.output("target_current"), atol=0.1, rtol=0.02
    )
    assert abs(c.output("actual_current")[1]) > 5.0, "the stretched arm is heavy"
    r.play(lambda host, k: k or host.speedj((1.0, 0, 0, 0, 0, 0), 10.0, 10.0))
    r.run(0.1)
    assert r.column(2)[:, 0].max() > 20.0, "it takes a torque to swing it"


@pytest.mark.parametrize("acceleration", [5.0, 40.0])
def test_fast_motion_of_the_arm_alone_is_no_collision(acceleration):
    r = rig()
    r.movej([0.8, -1.0, 0.8, 0.0, 0.5, 1.0], acceleration, 3.1)
    r.run(0.8)
    assert np.abs(r.column(1)).max() > 1.5
    assert np.abs(r.column(3)).max() < 15.0
    assert safety(r) is Cb3SafetyMode.NORMAL


def test_the_platform_at_its_limits_is_no_collision():
    r = rig(make=rollers)
    twist, goal = np.zeros(3), np.array([1.0, 0.0, 1.2])
    rate = np.array([1.2, 1.2, 2.0]) * 0.001

    def drive():
        nonlocal twist
        twist = twist + np.clip(goal - twist, -rate, rate)
        bench = r.bench
        bench.drives.command_velocity(bench.inverse @ twist, None, bench.now)

    r.during = drive
    r.run(0.6)
    goal = np.zeros(3)
    r.run(0.6)
    assert 8.0 < np.abs(r.column(3)).max() < 40.0, "the platform's acceleration shows"
    assert safety(r) is Cb3SafetyMode.NORMAL


@pytest.mark.parametrize(("declared", "is_stopped"), [(7.0, False), (0.0, True)])
def test_a_heavy_tool_is_a_collision_unless_it_is_declared(declared, is_stopped):
    r = rig(payload=declared, arm__mass=25.4)
    assert (safety(r) is Cb3SafetyMode.PROTECTIVE_STOP) is is_stopped


def test_the_model_of_the_controller_is_that_of_the_world_for_a_base_at_rest():
    bench = ideal("omniman")
    engine, arm, model = bench.world.engine, bench.world.arm, ArmDynamics(2.0)
    rng = np.random.default_rng(6)
    for _ in range(10):
        q, qd, qdd = rng.uniform(-3, 3, 6), rng.uniform(-3, 3, 6), rng.uniform(-9, 9, 6)
        arm.place(q)
        engine.velocities[:] = 0.0
        engine.velocities[arm.dofs] = qd
        engine.refresh()
        accelerations = np.zeros(len(engine.velocities))
        accelerations[arm.dofs] = qdd
        expected = (engine.inertial_forces(accelerations) + engine.bias)[arm.dofs]
        # Gravity is 9.82 m/s^2 in UR's documents, and 9.81 in the plant's parameters.
        np.testing.assert_allclose(model.torque(q, qd, qdd), expected, atol=0.002 * 80.0)


def drive_into_table(speed):
    """Lower the arm until it has touched the table and is stopped; return the time between [s]."""
    r = rig(RAISED, TABLE)
    touched = []

    def look():
        if any(contact.touches for contact in r.world.contacts):
            touched.append(r.bench.now)

    r.during = look
    r.movej([0.0, 1.0, *RAISED[2:]], 5.0, speed)
    while safety(r) is Cb3SafetyMode.NORMAL:
        r.cycle()
        assert r.time < 5.0
    return r, r.time - CYCLE - touched[0]


@pytest.mark.parametrize("speed", [0.8, 3.0])
def test_contact_is_a_protective_stop_that_presses_no_more(speed):
    r, delay = drive_into_table(speed)
    assert 0.0 < delay < 0.03
    assert r.controller.log[-1].startswith("protective stop: collision detected by joint 1")
    r.run(0.4)
    assert r.controller.runtime is Cb3RuntimeState.PAUSED
    assert np.abs(r.controller.arm.qd).max() < 0.01
    assert sum(np.linalg.norm(contact.force) for contact in r.world.contacts) < 100.0
    place = r.controller.arm.q
    r.run(0.4)
    np.testing.assert_allclose(r.controller.arm.q, place, atol=1e-3)


def test_after_unlocking_a_program_moves_the_arm_away_from_the_contact():
    r, _ = drive_into_table(1.0)
    r.controller.stop("given up")
    r.run(0.5)
    r.controller.modes = replace(r.controller.modes, stopped=r.time - 5.1)
    assert r.controller.unlock()
    r.movej(RAISED, 5.0, 2.0)
    r.run(1.2)
    assert safety(r) is Cb3SafetyMode.NORMAL
    np.testing.assert_allclose(r.controller.arm.q, RAISED, atol=1e-3)


def test_without_power_the_brakes_hold_the_arm():
    r = rig()
    assert r.controller.power(Cb3RobotMode.POWER_OFF)
    r.run(0.2)
    place = r.controller.arm.q
    assert r.controller.modes.robot is Cb3RobotMode.POWER_OFF
    np.testing.assert_array_equal(r.controller.arm.torque, 0.0)
    r.run(1.0)
    np.testing.assert_allclose(r.controller.arm.q, place, atol=1e-3)
    assert r.controller.power(Cb3RobotMode.RUNNING)
    r.run(2.0)
    assert r.controller.modes.ready
    np.testing.assert_allclose(r.controller.arm.q, place, atol=2e-3)
    assert abs(r.controller.arm.torque[1]) > 50.0


def test_a_lost_link_stops_the_joints_and_takes_their_power():
    r = rig(RAISED)
    r.play(lambda host, k: k or host.speedj((1.5, 0, 0, 0, 0, 0), 10.0, 10.0))
    r.run(0.4)
    r.link.cut()
    r.link.is_refused = True
    speeds = []
    for _ in range(30):
        r.cycle()
        speeds.append(r.world.arm.velocities[0])
    assert abs(speeds[-1]) < 1e-3
    assert np.diff(speeds).min() / CYCLE > -15.0 * 1.2
    c = r.controller
    assert (c.modes.robot, c.output("robot_mode")) == (Cb3RobotMode.DISCONNECTED, 0)
    assert c.runtime is Cb3RuntimeState.STOPPED and c.end_reason == "the arm does not answer"
    assert not c.power(Cb3RobotMode.RUNNING) and not c.start("test")

    r.link.is_refused = False
    r.run(0.3)
    assert c.modes.robot is Cb3RobotMode.POWER_OFF, "nothing moves again by itself"
    place = c.arm.q
    assert c.power(Cb3RobotMode.RUNNING)
    r.run(2.0)
    assert c.modes.ready
    np.testing.assert_allclose(c.arm.q, place, atol=2e-3)
    r.movej(RAISED, 5.0, 2.0)
    r.run(1.5)
    np.testing.assert_allclose(c.arm.q, RAISED, atol=1e-3)
