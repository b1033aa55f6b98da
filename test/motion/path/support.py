"""Limits, paths and checks shared by the tests of the path core."""

import numpy as np

from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.planner import PathPlanner
from omniman_ros.motion.path.trajectory import Trajectory

DT = 0.008
ROUND_OFF = 1e-6


def axes(tolerance: float = 0.05, heading_tolerance: float = 0.1, **changes) -> tuple:
    """Return platform axes with limits like those of the robots in config/."""
    linear = {"velocity": 0.5, "acceleration": 0.8, "jerk": 8.0} | changes
    return (
        AxisGroup((0, 1), tolerance=tolerance, **linear),
        AxisGroup((2,), 1.2, 1.2, 12.0, heading_tolerance),
    )


def random_path(seed: int, poses: int | None = None) -> np.ndarray:
    """Return a random walk from the origin whose steps and turns differ widely in size."""
    rng = np.random.default_rng(seed)
    k = poses or int(rng.integers(2, 15))
    steps = rng.normal(size=(k, 3)) * rng.choice([0.0, 0.01, 0.1, 1.0], size=(k, 1))
    steps[:, 2] *= rng.choice([0.0, 1.0])
    steps[-1, 0] += 0.3
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


def fractions(groups, positions_at, velocities, accelerations) -> dict[str, float]:
    """Return the largest used fraction of each limit; the jerk is constant between ticks."""
    jerks = np.diff(accelerations, axis=0) / DT
    return {
        name: max(float((g.norm(values) / getattr(g, name)).max()) for g in groups)
        for name, values in (
            ("velocity", velocities),
            ("acceleration", accelerations),
            ("jerk", jerks),
        )
    }


def continuity(positions, velocities, accelerations) -> float:
    """Return the largest distance of x and DT * x' at a tick from the preceding cubic [m]."""
    x, v, a = positions, velocities, accelerations
    place = x[:-1] + DT * v[:-1] + DT**2 * (a[:-1] / 3 + a[1:] / 6)
    speed = v[:-1] + DT * (a[:-1] + a[1:]) / 2
    return float(max(np.abs(x[1:] - place).max(), DT * np.abs(v[1:] - speed).max()))


def assert_smooth_within_limits(groups, positions, velocities, accelerations) -> None:
    """Assert that every limit holds at the ticks and between them, where the motion is cubic.

    Between two ticks the acceleration lies on the straight line between its end values, and the
    velocity is a parabola, which is checked in fine steps.
    """
    used = fractions(groups, positions, velocities, accelerations)
    assert max(used.values()) <= 1.0 + ROUND_OFF, used
    assert continuity(positions, velocities, accelerations) < 1e-9
    for fraction in np.linspace(0.0, 1.0, 6)[1:-1]:
        s = fraction * DT
        between = velocities[:-1] + s * accelerations[:-1]
        between = between + s * s / (2 * DT) * np.diff(accelerations, axis=0)
        fastest = max(float((g.norm(between) / g.velocity).max()) for g in groups)
        assert fastest <= 1.0 + ROUND_OFF


def planned(points, groups=None, cap=None) -> tuple:
    """Return the plan and the trajectory of a path from rest."""
    planner = PathPlanner(groups or axes(), DT, cap)
    plan = planner.plan(np.asarray(points, dtype=float))
    return plan, Trajectory(0.0, DT, plan.ticks, planner.smoother)


def off_path(positions: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance (k, 2) of poses from a polyline [m, rad].

    The first column is the distance to the nearest point. The second is the distance of the
    heading from the range of headings at the points that are about as near.
    """
    starts, steps = points[:-1], np.diff(points, axis=0)
    square = np.maximum((steps[:, :2] ** 2).sum(1), 1e-300)
    fraction = ((positions[:, None, :2] - starts[:, :2]) * steps[:, :2]).sum(2) / square
    fraction = np.clip(fraction, 0.0, 1.0)
    feet = starts[:, :2] + fraction[..., None] * steps[:, :2]
    distance = np.hypot(*np.moveaxis(positions[:, None, :2] - feet, 2, 0))
    return distance.min(axis=1)
