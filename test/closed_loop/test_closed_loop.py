"""Controller core and simulated drives in one loop: two independent models of one robot."""

import itertools
import math

import numpy as np
import pytest

from omniman_ros.core.arbiter import Source
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.lab.studies.closed_loop import ClosedLoop
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots

MODES = ("velocity", "torque", "voltage")
MISMATCHED = {
    "mismatch.friction": (1.5, 0.7, 1.2, 0.8),
    "mismatch.torque_constant": (1.1, 0.9, 1.05, 0.95),
    "mismatch.amplifier_gain": (1.05, 0.95, 0.97, 1.03),
}


class Loop(ClosedLoop):
    """A loop of a named robot with changes to its parameters and to the simulation's."""

    def __init__(self, robot: str, changes: dict | None = None, simulation: dict | None = None):
        super().__init__(
            robots.parameters(robot, changes), build(SimulationParameters, simulation or {})
        )


def figure_of_eight(start: float, duration: float) -> Preview:
    """Return a figure of eight, 2 m by 1.2 m, from rest to rest with an oscillating heading."""
    u = np.linspace(0.0, 1.0, round(duration / 0.02) + 1)
    phase = 2 * np.pi * u**3 * (10 - 15 * u + 6 * u**2)
    rate = 2 * np.pi * 30 * u**2 * (1 - u) ** 2 / duration
    change = 2 * np.pi * (60 * u - 180 * u**2 + 120 * u**3) / duration**2
    pose = np.column_stack([np.sin(phase), 0.6 * np.sin(2 * phase), 0.8 * np.sin(phase)])
    slope = np.column_stack([np.cos(phase), 1.2 * np.cos(2 * phase), 0.8 * np.cos(phase)])
    bend = np.column_stack([-np.sin(phase), -2.4 * np.sin(2 * phase), -0.8 * np.sin(phase)])
    velocity = slope * rate[:, None]
    acceleration = slope * change[:, None] + bend * rate[:, None] ** 2
    return Preview(start + u * duration, pose, velocity, acceleration)


def follow(loop: Loop, preview: Preview) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (k, 3) of odometry and of the true pose against the preview."""
    odometry, truth = [], []
    assert loop.controller.set_preview(Source.PATH, preview, loop.now) == ""
    while loop.now < preview.end:
        measured_at = loop.now
        loop.step()
        reference = preview.sample(measured_at).pose
        odometry.append(np.array(loop.controller.odometry.pose) - reference)
        truth.append(loop.drives.ground_truth()[0] - reference)
    assert loop.controller.latch.released, loop.controller.latch.status.reason
    return np.array(odometry), np.array(truth)


def fastest(preview: Preview) -> float:
    """Return the largest speed on the preview [m/s]."""
    times = np.linspace(preview.start, preview.end, 1000)
    return max(float(np.hypot(*preview.sample(now).velocity[:2])) for now in times)


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()))


# Each mode, robot and plant, and the pairs that differ most; the others run by hand.
REPRESENTATIVE = {
    ("omniman", "velocity", "mismatched"),
    ("omniman", "torque", "equal"),
    ("ig42", "voltage", "mismatched"),
}
PLANTS = {"equal": {}, "mismatched": MISMATCHED}


def every_mode():
    for robot, mode, plant in itertools.product(["omniman", "ig42"], MODES, PLANTS):
        marks = () if (robot, mode, plant) in REPRESENTATIVE else pytest.mark.exhaustive
        yield pytest.param(robot, mode, PLANTS[plant], id=f"{robot}-{mode}-{plant}", marks=marks)


@pytest.mark.parametrize(("robot", "mode", "simulation"), every_mode())
def test_preview_is_tracked_within_5_mm_rms_in_every_mode(robot, mode, simulation):
    loop = Loop(robot, {"drive.mode": mode}, simulation)
    preview = figure_of_eight(0.1, 24.0)
    assert fastest(preview) > 0.5
    odometry, truth = follow(loop, preview)
    assert rms(odometry) < 0.005, f"{1e3 * rms(odometry):.2f} mm"
    assert np.hypot(*truth[:, :2].T).max() < 0.03, "odometry lost the true pose"


@pytest.mark.parametrize(
    "robot",
    [
        pytest.param(name, marks=() if name == "omni3" else pytest.mark.exhaustive)
        for name in robots.TESTED
    ],
)
def test_preview_is_tracked_with_three_to_eight_wheels(robot):
    odometry, _ = follow(Loop(robot), figure_of_eight(0.1, 24.0))
    assert rms(odometry) < 0.005


def test_feed_forward_of_the_core_matches_the_needs_of_the_plant():
    """At constant speed in any direction the drives' loops add next to nothing."""
    for direction in np.linspace(0.0, np.pi, 4):
        loop = Loop("omniman")
        twist = np.array([0.4 * math.cos(direction), 0.4 * math.sin(direction), 0.3])
        for _ in range(600):
            loop.controller.set_twist(twist, loop.now)
            loop.step()
        asked = loop.controller.tick(loop.now).effort
        given = loop.drives.wheel_states(loop.now).effort
        assert np.abs(asked - given).max() < 0.15 * np.abs(asked).max()


def test_coupling_controller_reduces_the_coupling_error():
    largest = {}
    default = robots.parameters("omniman").coupling.k_epsilon
    for gain in (0.0, 2.0, default):
        loop = Loop("omniman", {"coupling.k_epsilon": gain}, MISMATCHED)
        errors = []
        for _ in range(1000):
            loop.controller.set_twist(np.array([0.3, 0.3, 0.0]), loop.now)
            loop.step()
            errors.append(abs(loop.controller.cascade.coupling.error[0]))
        largest[gain] = max(errors)
    assert largest[2.0] < 0.5 * largest[0.0]
    assert largest[default] < 0.25 * largest[0.0]


def test_speed_beyond_the_voltage_limit_causes_no_windup():
    """An overloaded IG42 on 14 V slows down at once when commanded to."""
    changes = {"drive.mode": "voltage", "motor.max_voltage": 14.0, "limits.linear_velocity": 2.0}
    loop = Loop("ig42", changes | {"drive.following_error": 100.0})
    for speed, ticks in ((1.8, 1200), (1.2, 80)):
        for _ in range(ticks):
            loop.controller.set_twist(np.array([speed, 0.0, 0.0]), loop.now)
            loop.step()
    asked, measured = loop.controller.setpoint[0], loop.drives.ground_truth()[1][0]
    assert measured == pytest.approx(asked, abs=0.05)


@pytest.mark.parametrize("mode", MODES)
def test_stop_in_every_mode_brings_the_true_robot_to_rest(mode):
    loop = Loop("omniman", {"drive.mode": mode})
    for _ in range(300):
        loop.controller.set_twist(np.array([0.3, -0.2, 0.4]), loop.now)
        loop.step()
    assert np.linalg.norm(loop.drives.ground_truth()[1]) > 0.4
    loop.controller.latch.stop("test")
    for _ in range(200):
        loop.step()
    assert np.abs(loop.drives.ground_truth()[1]).max() < 1e-3


def test_odometry_reports_slip_when_a_wheel_spins_on_a_slippery_patch():
    """In torque mode, because drives that control each wheel's speed hide slip from encoders."""
    patch = {
        "plant.patch_x_min": 0.6,
        "plant.patch_x_max": 3.0,
        "plant.patch_y_min": 0.0,
        "plant.patch_y_max": 2.0,
        "plant.patch_mu": 0.02,
    }
    slipped, variance = {}, {}
    for name, simulation in (("dry", {}), ("wet", patch)):
        loop = Loop("omniman", {"drive.mode": "torque"}, simulation)
        slipped[name] = False
        for i in range(1200):
            speed = 0.8 if i % 200 < 100 else 0.1
            loop.controller.set_twist(np.array([speed, 0.0, 0.0]), loop.now)
            loop.step()
            slipped[name] |= loop.controller.odometry.slipping
        variance[name] = loop.controller.odometry.covariance[0, 0]
    assert slipped == {"dry": False, "wet": True}
    assert variance["wet"] > 1.5 * variance["dry"]


@pytest.mark.parametrize("source_twist", [(1.0, 1.0, 1.0, 1.0), (-1.0, 1.0, 1.0, -1.0)])
def test_voltages_accelerate_within_what_the_posture_leaves(source_twist):
    """The plant judges; a large margin stands for a posture that bears little."""
    volts = 12.0 * np.array(source_twist)
    peaks = []
    for margin in (0.0, 0.25):
        loop = Loop("omniman", {"stability.margin": margin})
        core, twists = loop.controller, []
        for _ in range(80):
            core.set_voltages(volts, loop.now)
            loop.step()
            twists.append(loop.drives.ground_truth()[1])
        rates = np.diff(np.array(twists)[::8], axis=0) / 0.04
        peaks.append(float(np.hypot(rates[:, 0], rates[:, 1]).max()))
    fraction, limit = (
        core.stability.fraction,
        max(core.limits.linear_acceleration, core.limits.linear_deceleration),
    )
    assert fraction < 1.0
    assert peaks[1] < 1.15 * limit < peaks[0]
