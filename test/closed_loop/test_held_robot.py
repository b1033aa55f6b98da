"""A robot that is held in the physics world is noticed, and a free one is not.

The world shares no model with the controller: bodies, contacts, rollers and friction are the
engine's.
"""

import numpy as np
import pytest

from omniman_ros.core.arbiter import Source
from omniman_ros.core.imu_mount import ImuMount
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.simulation.plant.imu import ImuSensorParameters, SimulatedImu
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.scene_files import scene_of
from omniman_ros.simulation.world.parameters import WorldParameters
from test import robots
from test.closed_loop.test_closed_loop import MISMATCHED, MODES
from test.tiers import exhaustive

pytest.importorskip("mujoco")


LATEST = 1.0  #: Longest time from the contact to the stop [s]
LOW = 0.35  #: Height of walls and posts, which the arm passes above [m]


class Ride:
    """A robot in a scene, driven by cmd_vel; with `imu`, it has an inertial sensor."""

    def __init__(
        self,
        name="omniman",
        scene=None,
        mode="velocity",
        wheels="ideal",
        imu=False,
        torques=True,
        **changes,
    ):
        plain = {key.replace("__", "."): value for key, value in changes.items()}
        values = robots.values(name, plain)
        description = build(DescriptionParameters, values)
        simulation = build(SimulationParameters, values)
        parameters = build(WorldParameters, {**values, "world.wheels": wheels}, "world.")
        choice = WorldChoice(description, parameters, scene_of(scene or {}, "scene"))
        self.loop = ClosedLoop(
            robots.parameters(name, {"drive.mode": mode, **plain}),
            simulation,
            torques,
            choice,
        )
        self.world = self.loop.world
        self.core = self.loop.controller
        self.imu = None
        if imu:
            errors = build(ImuSensorParameters, values, "imu_sensor.")
            self.imu = SimulatedImu(build(ImuMount, values, "imu."), errors, 9.81)

    @property
    def reason(self):
        return self.core.latch.status.reason

    def step(self):
        """Run one tick."""
        now = self.loop.now
        if self.imu is not None and self.loop.tick % 2 == 0:
            measured = self.imu.measure(now, self.world.base_motion)
            if measured is not None:
                self.core.imu.update(now, now, *measured)
        self.loop.step()

    def rest(self, seconds):
        """Let time pass without a setpoint."""
        for _ in range(round(seconds / PERIOD)):
            self.step()

    def go(self, twist, seconds):
        """Drive; return the time for which the robot touched something before it stopped [s]."""
        touched, twist = None, np.array(twist)
        for _ in range(round(seconds / PERIOD)):
            self.core.set_twist(twist, self.loop.now)
            self.step()
            if touched is None and any(contact.touches for contact in self.world.contacts):
                touched = self.loop.now
            if not self.core.latch.released:
                return None if touched is None else self.loop.now - touched
        return None


def wall_ahead(distance):
    x = 0.5 + distance + 0.05
    return {"walls": [{"name": "wall", "x": [x, x], "y": [-3, 3], "height": LOW}]}


def wall_beside(distance):
    y = 0.35 + distance + 0.05
    return {"walls": [{"name": "wall", "x": [-3, 3], "y": [y, y], "height": LOW}]}


TABLE = {
    "tables": [{"name": "table", "x": 1.1, "y": 0, "length": 0.8, "width": 1.6, "height": 0.45}]
}
POSTS = {
    "posts": [
        {"name": f"post_{side:g}", "x": 0.45 * side, "y": 0.47 * side, "height": LOW}
        for side in (1, -1)
    ]
}
PERSON = {"persons": [{"name": "anna", "x": [1.1], "y": [0.0]}]}
CASES = {
    "wall, fast": (wall_ahead(0.6), (0.5, 0.0, 0.0), {}),
    "wall, slow": (wall_ahead(0.1), (0.1, 0.0, 0.0), {}),
    "wall, creeping": (wall_ahead(0.03), (0.03, 0.0, 0.0), {}),
    "table": (TABLE, (0.3, 0.0, 0.0), {}),
    "sideways": (wall_beside(0.2), (0.0, 0.3, 0.0), {}),
    "obliquely": (wall_ahead(0.2), (0.25, 0.15, 0.0), {}),
    "turning": (POSTS, (0.0, 0.0, 0.4), {}),
    "turning slowly": (POSTS, (0.0, 0.0, 0.1), {}),
    "person of 200 N": (PERSON, (0.3, 0.0, 0.0), {"world__person_force": 200.0}),
    "person of 150 N": (PERSON, (0.3, 0.0, 0.0), {"world__person_force": 150.0}),
    "wheels stall by grip": (wall_ahead(0.2), (0.3, 0.0, 0.0), {"friction__mu": 3.0}),
    "wheels stall by current": (wall_ahead(0.2), (0.3, 0.0, 0.0), {"motor__max_current": 8.0}),
}
DAILY = {(case, "velocity") for case in CASES} | {("table", "torque"), ("turning", "voltage")}


def held_cases():
    for case in CASES:
        for mode in MODES:
            yield pytest.param(
                case, mode, marks=() if (case, mode) in DAILY else pytest.mark.exhaustive
            )


@pytest.mark.parametrize(("case", "mode"), list(held_cases()))
def test_a_held_robot_is_noticed_within_a_second(case, mode):
    scene, twist, changes = CASES[case]
    ride = Ride(scene=scene, mode=mode, **changes)
    delay = ride.go(twist, 4.0)
    assert "the robot is held" in ride.reason
    assert delay <= LATEST


@pytest.mark.exhaustive
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("case", list(CASES))
def test_a_held_robot_on_rollers_is_noticed_within_a_second(case, mode):
    scene, twist, changes = CASES[case]
    ride = Ride(scene=scene, mode=mode, wheels="rollers", **changes)
    delay = ride.go(twist, 4.0)
    assert "the robot is held" in ride.reason
    assert delay <= LATEST


def test_a_robot_that_voltages_push_against_a_wall_is_noticed():
    ride = Ride(scene=wall_ahead(0.2))
    for _ in range(400):
        ride.core.set_voltages(np.full(4, 7.0), ride.loop.now)
        ride.step()
    assert "the robot is held" in ride.reason


@pytest.mark.parametrize("case", ["wall, fast", "table", "turning"])
def test_without_torques_a_sensor_notices_collisions_and_turns(case):
    scene, twist, changes = CASES[case]
    ride = Ride(scene=scene, imu=True, torques=False, **changes)
    ride.rest(0.6)
    delay = ride.go(twist, 3.0)
    assert "imu" in ride.reason and delay <= LATEST


# ---- the sensor and the odometry ------------------------------------------------------------


@pytest.mark.exhaustive
@pytest.mark.parametrize(("imu", "heading", "distance"), [(False, 0.08, 0.07), (True, 0.01, 0.02)])
def test_the_odometry_on_rollers_after_figure_7(imu, heading, distance):
    """Errors at the end; without the sensor 0.076 rad and 65 mm, with it 0.002 rad and 13 mm."""
    ride = Ride(wheels="rollers", imu=imu)
    ride.rest(1.5)
    for leg in Figure7().legs(ride.loop.now):
        ride.rest(leg.begin - ride.loop.now)
        assert ride.core.set_preview(Source.PATH, leg.preview, ride.loop.now) == ""
        ride.rest(leg.preview.end - ride.loop.now)
    ride.rest(1.0)
    error = np.array(ride.core.odometry.pose) - ride.world.pose
    assert ride.core.latch.released, ride.reason
    assert abs(error[2]) < heading and np.hypot(*error[:2]) < distance


# ---- no false alarm -------------------------------------------------------------------------

TROUBLES = {
    "none": {},
    "parts differ": {key.replace(".", "__"): value for key, value in MISMATCHED.items()},
    "friction doubled": {"mismatch__friction": (2.0,)},
    "sagging supply": {"mismatch__amplifier_gain": (0.8,)},
    "noisy currents": {"faults__current_noise": 1.0},
    "slippery floor": {"friction__mu": 0.25},
}
LOADS = {
    "loads": [
        {"name": "part", "x": -0.25, "y": 0.1, "mass": 20.0},
        {"name": "box", "x": -0.25, "y": -0.2, "length": 0.2, "width": 0.2, "mass": 10.0},
    ]
}


def roam(ride, seconds, seed):
    """Drive at random within the limits, up to both velocity limits, with reversals and stops."""
    rng = np.random.default_rng(seed)
    limits = ride.core.parameters.limits
    end = ride.loop.now + seconds
    while ride.loop.now < end and ride.core.latch.released:
        angle = rng.uniform(-np.pi, np.pi)
        speed = rng.choice([0.0, 0.05, 0.3, 1.0, 1.0]) * limits.linear_velocity
        turn = rng.choice([0.0, 0.0, 0.1, -1.0, 1.0]) * limits.angular_velocity
        twist = (speed * np.cos(angle), speed * np.sin(angle), turn)
        if rng.random() < 0.1:  # silence: the controller ramps down by itself
            ride.rest(1.0)
        else:
            ride.go(twist, rng.uniform(0.3, 2.5))


@pytest.mark.parametrize(
    ("trouble", "mode"),
    [
        exhaustive("none", "velocity"),
        ("parts differ", "torque"),
        exhaustive("slippery floor", "voltage"),
    ],
)
def test_free_driving_is_no_alarm(trouble, mode):
    ride = Ride(mode=mode, scene=LOADS, imu=True, **TROUBLES[trouble])
    roam(ride, 4.0, seed=3)
    assert ride.core.latch.released, ride.reason


HOUR = [(trouble, mode) for trouble in TROUBLES for mode in MODES]


@pytest.mark.exhaustive
@pytest.mark.parametrize("wheels", ["ideal", "rollers"])
@pytest.mark.parametrize(("trouble", "mode"), HOUR)
def test_an_hour_of_free_driving_is_no_alarm(trouble, mode, wheels):
    """All cases together drive for more than an hour.

    Under torque control on rollers, wheels stray from their setpoints, which is another stop.
    """
    changes = TROUBLES[trouble] | {"drive__following_error": 100.0}
    for k, robot in enumerate(("omniman", "ig42")):
        scene = LOADS if robot == "omniman" else None
        ride = Ride(robot, mode=mode, wheels=wheels, scene=scene, imu=True, **changes)
        roam(ride, 1.02 * 3600.0 / (4 * len(HOUR)), seed=100 + k)
        assert ride.core.latch.released, ride.reason
