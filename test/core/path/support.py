"""Limits, paths and checks that tests of the path core share."""

import numpy as np

from omniman_ros.core.path.axes import AxisGroup
from omniman_ros.core.path.planner import PathPlanner
from omniman_ros.core.path.trajectory import Trajectory

DT = 0.008
ROUND_OFF = 1e-6


def axes(tolerance: float = 0.05, heading_tolerance: float = 0.1, **changes) -> tuple:
    """Platform axes with limits like those of the robots in config/."""
    linear = {"velocity": 0.5, "acceleration": 0.8, "jerk": 8.0} | changes
    return (
        AxisGroup((0, 1), tolerance=tolerance, **linear),
        AxisGroup((2,), 1.2, 1.2, 12.0, heading_tolerance),
    )


def random_path(seed: int, poses: int | None = None) -> np.ndarray:
    """A random walk with steps and turns of very different size, from the origin."""
    rng = np.random.default_rng(seed)
    k = poses or int(rng.integers(2, 15))
    steps = rng.normal(size=(k, 3)) * rng.choice([0.0, 0.01, 0.1, 1.0], size=(k, 1))
    steps[:, 2] *= rng.choice([0.0, 1.0])
    steps[-1, 0] += 0.3
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


def shares(groups, positions_at, velocities, accelerations) -> dict[str, float]:
    """Largest share of each limit; the jerk is constant between ticks."""
    jerks = np.diff(accelerations, axis=0) / DT
    return {
        name: max(float((g.norm(values) / getattr(g, name)).max()) for g in groups)
        for name, values in (
            ("velocity", velocities), ("acceleration", accelerations), ("jerk", jerks),
        )
    }  # fmt: skip


def continuity(positions, velocities, accelerations) -> float:
    """How far x and x' at a tick are from the cubic of the tick before [m]."""
    x, v, a = positions, velocities, accelerations
    place = x[:-1] + DT * v[:-1] + DT**2 * (a[:-1] / 3 + a[1:] / 6)
    speed = v[:-1] + DT * (a[:-1] + a[1:]) / 2
    return float(max(np.abs(x[1:] - place).max(), DT * np.abs(v[1:] - speed).max()))


def assert_smooth_within_limits(groups, positions, velocities, accelerations) -> None:
    """Every limit holds at the ticks and, for they are cubics there, between them.

    Velocity and acceleration vectors between two ticks of a cubic: the acceleration is on the
    straight between its ends; the velocity is a parabola, looked at in fine steps.
    """
    used = shares(groups, positions, velocities, accelerations)
    assert max(used.values()) <= 1.0 + ROUND_OFF, used
    assert continuity(positions, velocities, accelerations) < 1e-9
    for share in np.linspace(0.0, 1.0, 6)[1:-1]:
        s = share * DT
        between = velocities[:-1] + s * accelerations[:-1]
        between = between + s * s / (2 * DT) * np.diff(accelerations, axis=0)
        fastest = max(float((g.norm(between) / g.velocity).max()) for g in groups)
        assert fastest <= 1.0 + ROUND_OFF


def planned(points, groups=None, cap=None) -> tuple:
    """Plan and trajectory from rest."""
    planner = PathPlanner(groups or axes(), DT, cap)
    plan = planner.plan(np.asarray(points, dtype=float))
    return plan, Trajectory(0.0, DT, plan.ticks, planner.smoother)


def off_path(positions: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance (k, 2) of poses from a polyline: [m] to its nearest place, [rad] to its headings.

    The heading's distance is to the range of headings of the places that are about as near.
    """
    starts, steps = points[:-1], np.diff(points, axis=0)
    square = np.maximum((steps[:, :2] ** 2).sum(1), 1e-300)
    share = ((positions[:, None, :2] - starts[:, :2]) * steps[:, :2]).sum(2) / square
    share = np.clip(share, 0.0, 1.0)
    feet = starts[:, :2] + share[..., None] * steps[:, :2]
    distance = np.hypot(*np.moveaxis(positions[:, None, :2] - feet, 2, 0))
    return distance.min(axis=1)
