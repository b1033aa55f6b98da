"""Dead motors and stuck wheels on the plant: detection, report, driving on and stopping.

The detector is independent of the plant; times are simulated.
"""

import itertools

import numpy as np
import pytest

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots
from test.closed_loop.test_closed_loop import MODES, Loop, fastest, figure_of_eight, follow, rms
from test.tiers import combinations, exhaustive, representative

ON = {"drive.dead_wheel": "drive_on"}
FORWARD, SIDEWAYS, TURN = (0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.4)
OBLIQUE = (0.2, 0.1, 0.1)
#: Twist that demands a driving torque of every wheel, without any other one, too
DEMANDING = {"omniman": OBLIQUE, "mecanum6": OBLIQUE, "mecanum8": FORWARD}


class Course:
    """A loop driven by cmd_vel that records detected faults."""

    def __init__(self, robot="omniman", changes=None, simulation=None):
        self.loop = Loop(robot, changes, simulation)
        self.simulation = simulation or {}
        self.core, self.drives = self.loop.controller, self.loop.drives
        self.names = self.core.parameters.robot.wheels.names

    def fault(self, **faults):
        """Set faults of the simulation by name."""
        named = {f"faults.{name}": wheels for name, wheels in faults.items()}
        self.drives.set_parameters(build(SimulationParameters, {**self.simulation, **named}))

    def go(self, twist, seconds):
        """Drive and return the time of the first dead wheel or latched stop [s], or None."""
        start, found = self.loop.now, None
        for _ in range(round(seconds / PERIOD)):
            self.core.set_twist(np.array(twist), self.loop.now)
            self.loop.step()
            if found is None and (self.core.wheel_health.dead or not self.core.latch.released):
                found = self.loop.now - start
        return found

    @property
    def twist(self):
        """Return the true twist."""
        return self.drives.ground_truth()[1]


def check_drives_on(course, wheel, twist, found, within):
    assert course.core.wheel_health.dead == course.core.wheel_health.idle == (wheel,)
    assert course.core.latch.released, course.core.latch.status
    assert course.drives.stop_reason is None
    assert found < within
    np.testing.assert_allclose(course.twist, twist, atol=0.02)
    assert "dead: driving on without" in course.core.wheel_health.notice


@pytest.mark.parametrize(
    ("robot", "twist", "mode"),
    combinations(["omniman", "ig42"], [FORWARD, SIDEWAYS, TURN], MODES),
)
def test_robot_drives_on_without_a_motor_that_dies_in_motion(robot, twist, mode):
    course = Course(robot, ON | {"drive.mode": mode})
    assert course.go(twist, 1.5) is None
    course.fault(dead_motor=(course.names[0],))
    found = course.go(twist, 2.0)
    check_drives_on(course, 0, twist, found, within=0.7)


@pytest.mark.parametrize(
    "robot", representative(["mecanum6", "omniman", "skewed4", "mecanum8"], every=4)
)
def test_every_dead_wheel_is_distinguished_from_its_neighbours(robot):
    """The neighbour of a dead wheel may also give no torque."""
    for wheel in range(robots.robot(robot).wheel_count):
        course = Course(robot, ON)
        course.go(FORWARD, 1.0)
        course.fault(dead_motor=(course.names[wheel],))
        found = course.go(FORWARD, 1.4)
        check_drives_on(course, wheel, FORWARD, found, within=1.0)


@pytest.mark.parametrize("mode", MODES)
def test_motor_dead_from_the_start_is_detected_within_the_first_metre(mode):
    course = Course("ig42", ON | {"drive.mode": mode}, {"faults.dead_motor": ("rear_left",)})
    found = course.go(FORWARD, 2.5)
    check_drives_on(course, 2, FORWARD, found, within=0.7)
    assert np.hypot(*(course.drives.ground_truth()[0] - course.core.odometry.pose)[:2]) < 0.03


def test_dead_motor_by_default_stops_the_robot_within_its_limits():
    course = Course()
    course.go((0.6, 0.0, 0.2), 2.0)
    course.fault(dead_motor=("rear_right",))
    assert course.go((0.6, 0.0, 0.2), 0.7) is not None
    assert course.core.latch.status.reason == "wheel 'rear_right' is dead: no torque"
    before = course.twist
    limits, start = course.core.parameters.limits, course.loop.now
    while np.abs(course.twist).max() > 1e-3:
        course.go((0.6, 0.0, 0.2), PERIOD)
        assert abs(course.twist[0] - before[0]) / PERIOD < 1.5 * limits.linear_deceleration
        before = course.twist
        assert course.loop.now - start < 1.5
    assert abs(course.drives.wheel_states(course.loop.now).velocity).max() < 0.05


@pytest.mark.parametrize(
    ("robot", "mode"),
    [
        pytest.param("omniman", "velocity", marks=pytest.mark.exhaustive),
        pytest.param("ig42", "torque", marks=pytest.mark.exhaustive),
    ],
)
def test_path_is_tracked_with_three_wheels(robot, mode):
    """One motor dies during the path; speeds up to 0.46 m/s are within the reduced limits."""
    loop = Loop(robot, ON | {"drive.mode": mode})
    preview = figure_of_eight(0.1, 40.0)
    assert fastest(preview) < 0.5
    done = []

    def die():
        if not done and loop.now > 10.0:
            done.append(True)
            dead = {"faults.dead_motor": ("front_left",)}
            loop.drives.set_parameters(build(SimulationParameters, dead))

    step = loop.step

    def stepping():
        die()
        step()

    loop.step = stepping
    odometry, truth = follow(loop, preview)
    assert loop.controller.wheel_health.idle == (0,)
    assert rms(odometry) < 0.02, f"{1e3 * rms(odometry):.2f} mm"
    assert np.hypot(*(truth - odometry)[:, :2].T).max() < 0.05
    assert np.abs(np.diff(odometry, axis=0)[:, :2]).max() < 0.01, "a jump"


def pairs(*names):
    """Return every pair of wheels of some robots, to fail at once and one after the other."""
    return [
        (name, pair, order)
        for name in names
        for pair in itertools.combinations(range(robots.robot(name).wheel_count), 2)
        for order in ("at once", "in turn", "in turn, reversed")
    ]


def loss_id(loss):
    robot, pair, order = loss
    return f"{robot}-{pair[0]},{pair[1]}-{order}"


def lose_two(course, pair, order, twist):
    """Let two motors die in motion, and drive until both are found or the robot stops."""
    health, latch = course.core.wheel_health, course.core.latch
    course.go(twist, 0.8)
    assert latch.released and not health.dead
    sequence = pair[::-1] if order.endswith("reversed") else pair
    for count in (2,) if order == "at once" else (1, 2):
        course.fault(dead_motor=tuple(course.names[wheel] for wheel in sequence[:count]))
        end = course.loop.now + 2.5
        while course.loop.now < end and len(health.dead) < count and latch.released:
            course.go(twist, PERIOD)


@pytest.mark.parametrize(
    "loss", representative(pairs("mecanum6", "mecanum8"), every=64), ids=loss_id
)
def test_six_and_eight_wheels_drive_on_without_any_two(loss):
    robot, pair, order = loss
    course, twist = Course(robot, ON), DEMANDING[robot]
    lose_two(course, pair, order, twist)
    assert course.core.wheel_health.dead == course.core.wheel_health.idle == pair
    start = course.drives.ground_truth()[0] - course.core.odometry.pose
    course.go(twist, 1.0)
    np.testing.assert_allclose(course.twist, twist, atol=0.02)
    assert course.core.latch.released, course.core.latch.status
    drift = course.drives.ground_truth()[0] - course.core.odometry.pose - start
    assert np.hypot(*drift[:2]) < 0.02 and abs(drift[2]) < 0.03
    course.fault()
    course.go((0.0, 0.0, 0.0), 0.6)
    course.drives.reset()
    course.core.reset(course.loop.now)
    assert course.core.wheel_health.idle == ()
    assert course.core.wheel_health.limits == course.core.parameters.limits


@pytest.mark.parametrize("loss", representative(pairs("omniman"), every=5), ids=loss_id)
def test_four_wheels_stop_within_their_limits_without_any_two(loss):
    robot, pair, order = loss
    course = Course(robot, ON)
    lose_two(course, pair, order, OBLIQUE)
    core = course.core
    assert core.latch.status.reason.endswith("the others do not determine the twist well")
    assert set(core.wheel_health.dead) == set(pair) and core.wheel_health.stopping
    limits, start = core.parameters.limits, course.loop.now
    while not core.at_rest:
        before = core.setpoint
        course.go(OBLIQUE, PERIOD)
        step = (core.setpoint - before) / PERIOD
        assert np.hypot(*step[:2]) <= limits.linear_deceleration + 1e-9
        assert abs(step[2]) <= limits.angular_deceleration + 1e-9
        assert course.loop.now - start < 1.0
    course.go(OBLIQUE, 0.5)
    assert abs(course.drives.wheel_states(course.loop.now).velocity).max() < 0.05
    assert not core.latch.released, "a stop is latched until ~/reset"


def test_second_dead_motor_without_demanded_torque_is_found_once_the_motion_needs_it():
    """Forward, the front right wheel gives no torque if the front left one is dead."""
    course = Course("omniman", ON)
    course.go(FORWARD, 1.0)
    course.fault(dead_motor=("front_left",))
    course.go(FORWARD, 1.0)
    course.fault(dead_motor=("front_left", "front_right"))
    course.go(FORWARD, 2.0)
    assert course.core.latch.released and course.core.wheel_health.idle == (0,)
    np.testing.assert_allclose(course.twist, FORWARD, atol=0.02)
    course.go(SIDEWAYS, 1.5)
    assert "'front_right' is dead" in course.core.latch.status.reason
    assert np.abs(course.twist).max() < 1e-3


@pytest.mark.parametrize("seed", representative(range(12), every=12))
def test_four_wheels_without_two_stop_unless_the_twist_is_the_commanded_one(seed):
    """The motion may hardly demand torque of the second wheel; then its loss does no harm."""
    rng = np.random.default_rng(seed)
    twist = tuple(rng.uniform(-1.0, 1.0, 3) * [0.25, 0.25, 0.3])
    pair = tuple(sorted(rng.choice(4, 2, replace=False).tolist()))
    course = Course("omniman", ON)
    lose_two(course, pair, rng.choice(["at once", "in turn"]), twist)
    course.go(twist, 1.0)
    if course.core.latch.released:
        np.testing.assert_allclose(course.twist, twist, atol=0.03)
    else:
        assert np.abs(course.twist).max() < 1e-3


@pytest.mark.parametrize("mode", [exhaustive("voltage"), "torque"])
def test_weakly_determined_twist_is_followed_through_sharp_turns(mode):
    """Under torque control the wheels would lose their grip in the first turn, and swing."""
    rear = ("rear_right", "rear_left")
    course = Course(
        "mecanum6", {"drive.dead": rear, "drive.mode": mode}, {"faults.dead_motor": rear}
    )
    for twist in (FORWARD, SIDEWAYS, (-0.2, -0.2, 0.1)):
        course.go(twist, 2.2)
        np.testing.assert_allclose(course.twist, twist, atol=0.03)
    assert course.core.latch.released, course.core.latch.status


@pytest.mark.parametrize(("robot", "mode"), combinations(["omniman", "ig42", "omni3"], MODES))
def test_stuck_wheel_stops_the_robot_soon_even_under_drive_on(robot, mode):
    course = Course(robot, ON | {"drive.mode": mode})
    course.go(FORWARD, 1.5)
    course.fault(stuck_wheel=(course.names[0],))
    assert course.go(FORWARD, 2.0) < 0.6
    reason = course.core.latch.status.reason
    assert f"'{course.names[0]}'" in reason and "dead" not in reason
    assert course.core.wheel_health.idle == ()
    assert np.abs(course.twist).max() < 1e-3


# ---- no false alarm ---------------------------------------------------------------------------


def ride(seed, robot, mode, seconds, trouble):
    """Drive randomly with 20 % part mismatch; return the stop reason and number of probes."""
    rng = np.random.default_rng(seed)
    n = robots.robot(robot).wheel_count

    def spread(fraction=0.2):
        return tuple((1.0 + rng.uniform(-fraction, fraction, n)).tolist())

    simulation = {
        "mismatch.friction": spread(),
        "mismatch.torque_constant": spread(),
        "mismatch.amplifier_gain": spread(),
        "firmware.encoder_tolerance": 1e6,
    }
    if trouble == "noise":
        simulation["faults.current_noise"] = 0.2
    if trouble == "ice":
        simulation |= {
            "plant.patch_x_min": 0.2,
            "plant.patch_x_max": 1.2,
            "plant.patch_y_min": -5.0,
            "plant.patch_y_max": 5.0,
            "plant.patch_mu": 0.05,
        }
    loop = Loop(robot, {"drive.mode": mode, "drive.following_error": 1000.0}, simulation)
    core, limits = loop.controller, loop.controller.parameters.limits
    if trouble == "load":
        heavy = {
            k: v * 1.5
            for k, v in robots.values(robot).items()
            if k in ("body.mass", "body.inertia")
        }
        heavy_robot = build(Platform, {**robots.values(robot), **heavy})
        loop.drives.configure(heavy_robot, build(SimulationParameters, simulation))
    asked, left = 0, 0
    for _ in range(round(seconds / PERIOD)):
        if left == 0:
            left = int(rng.integers(60, 500))
            scale = rng.uniform(0.03, 1.0) * (rng.uniform(size=3) < 0.6)
            twist = scale * rng.uniform(-1.0, 1.0, 3)
            twist *= [*[limits.linear_velocity] * 2, limits.angular_velocity]
        left -= 1
        if trouble == "ice" and not -0.5 < loop.truth[0] < 2.0:
            loop.drives.set_pose([0.0, 0.0, rng.uniform(-3, 3)])
        core.set_twist(twist, loop.now)
        probing = core.wheel_health.probe(loop.now) is not None
        loop.step()
        asked += core.wheel_health.probe(loop.now) is not None and not probing
        if not core.latch.released:
            break
    return core.latch.status.reason, asked


TROUBLES = ("none", "noise", "ice", "load")


@pytest.mark.parametrize(
    ("seed", "robot", "mode", "trouble"),
    [
        pytest.param(
            k,
            ("omniman", "ig42", "omni3", "mecanum6", "mecanum8")[k % 5],
            MODES[k % 3],
            TROUBLES[k % 4],
            marks=[pytest.mark.exhaustive] if k > 3 else [],
        )
        for k in range(8)
    ],
)
def test_no_healthy_wheel_is_reported_as_dead(seed, robot, mode, trouble):
    seconds = 6
    reason, asked = ride(seed, robot, mode, seconds, trouble)
    assert reason == ""
    assert asked <= seconds


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("mode", "twist", "wheel"),
    [
        ("velocity", (0.3, 0.0, 0.0), "front_left"),
        ("torque", (0.2, 0.2, 0.2), "rear_left"),
        ("velocity", (0.0, 0.0, 0.6), "rear_left"),
    ],
)
def test_a_dead_wheel_on_rollers_is_found_within_a_second_and_no_other(mode, twist, wheel):
    pytest.importorskip("mujoco")
    values = robots.values("omniman", {"drive.mode": mode})
    dead = build(SimulationParameters, {**values, "faults.dead_motor": (wheel,)})
    parameters, simulation = build(PlatformParameters, values), build(SimulationParameters, values)
    loop = ClosedLoop(parameters, simulation, world=WorldChoice.of(values, "rollers"))

    def drive(ticks):
        for _ in range(ticks):
            loop.controller.set_twist(np.array(twist), loop.now)
            loop.step()

    drive(300)
    assert loop.controller.latch.released
    loop.drives.set_parameters(dead)
    drive(200)
    assert loop.controller.latch.status.reason == f"wheel '{wheel}' is dead: no torque"
