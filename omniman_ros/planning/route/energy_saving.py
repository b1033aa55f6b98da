"""Straight lines driven in the heading that requires the least energy.

Mecanum wheels require about as much energy along a roller diagonal as straight ahead, and up to
twice as much sideways: over a few metres it saves energy to rotate first. The optimisation cannot
detect that within its horizon of one or two seconds; a route can.
"""

import math

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.planning.mpc.model import PlanningModel

#: Smallest fraction of the energy that a rotation must save [-]: corrections offset a smaller one
MIN_SAVING = 0.07
#: Factor on the limit of the yaw rate at which the robot rotates while it drives [-]
YAW_RATE_FACTOR = 0.7
#: Expected heading error [rad]: along a diagonal one degree may cost a tenth of the energy
HEADING_ERROR = math.radians(2.0)
HEADINGS = 36  #: Number of headings that are compared
ROTATION_SAMPLES = 7  #: Number of samples of each rotation


def power(model: PlanningModel, twists: Array) -> Array:
    """Return the electric power (...) [W] at constant body twists (..., 3).

    It is that of the smallest currents that balance the model's friction, MPC 2021 (21) to (24).
    """
    wheels, rollers = twists @ model.J.T, twists @ model.rolling.T
    wheel_friction = model.viscous * wheels + model.coulomb * _sign(wheels)
    force = wheel_friction @ model.J + (model.drag * _sign(rollers)) @ model.rolling
    currents = force @ np.linalg.pinv(model.J) / (model.efficiency * model.emf)
    result: Array = (model.voltages(currents, twists) * currents).sum(axis=-1)
    return result


def straight(
    model: PlanningModel, start: Array, goal: Array, speeds: tuple[float, float]
) -> Array:
    """Return poses (K, 3) along a straight line, in the heading that requires the least energy.

    The goal's heading is on the branch of arrival; speeds are in m/s and rad/s.

    Args:
        speeds: Linear [m/s] and angular [rad/s] speed along the line.
    """
    heading = _cruise(model, start, goal, speeds)
    if heading is None:
        return np.array([start, goal])
    ahead = goal[:2] - start[:2]
    distance = math.hypot(ahead[0], ahead[1])
    first = heading - start[2]
    last = goal[2] - heading
    lengths = np.array([0.0, abs(first), abs(last)]) * speeds[0] / (YAW_RATE_FACTOR * speeds[1])
    fractions = np.array([0.0, lengths[1], distance - lengths[2], distance]) / distance
    headings = np.array([start[2], heading, heading, goal[2]])
    positions = start[:2] + fractions[:, None] * ahead
    return np.column_stack([positions, headings])


def _cruise(
    model: PlanningModel, start: Array, goal: Array, speeds: tuple[float, float]
) -> float | None:
    """Return the heading that saves enough energy to rotate to it [rad]; None if there is none."""
    ahead = goal[:2] - start[:2]
    distance, bearing = math.hypot(ahead[0], ahead[1]), math.atan2(ahead[1], ahead[0])
    speed, yaw_rate = speeds[0], YAW_RATE_FACTOR * speeds[1]
    around = np.arange(HEADINGS) * (math.tau / HEADINGS)
    middle = 0.5 * (start[2] + goal[2])
    headings = middle + np.array([se2.wrap(angle) for angle in bearing - around - middle])
    rotations = np.abs(np.column_stack([headings - start[2], goal[2] - headings]))
    lengths = rotations * (speed / yaw_rate)
    cruising = distance - lengths.sum(axis=1)
    fits = cruising > 0.0
    if not fits.any():
        return None
    headings, rotations, lengths, cruising = (
        part[fits] for part in (headings, rotations, lengths, cruising)
    )
    directions = bearing - headings[:, None] + _heading_errors()
    energy = power(model, _twists(speed, directions, 0.0)).mean(axis=1) * cruising / speed
    fraction = (np.arange(ROTATION_SAMPLES) + 0.5) / ROTATION_SAMPLES
    for k, other in enumerate((start[2], goal[2])):
        between = other + fraction * (headings - other)[:, None]
        # The robot rotates from the heading of the start, or to that of the goal.
        signs = np.sign(headings - other) * (1.0 if k == 0 else -1.0)
        rate = yaw_rate * signs[:, None]
        mean_power = power(model, _twists(speed, bearing - between, rate)).mean(axis=1)
        spin_energy = 0.5 * model.inertia[2, 2] * yaw_rate**2 / model.efficiency
        energy += mean_power * lengths[:, k] / speed
        energy += spin_energy * np.minimum(rotations[:, k] / 0.2, 1.0)
    plain = _plain(model, start, goal, distance, bearing, speeds)
    best = int(energy.argmin())
    return float(headings[best]) if energy[best] < (1.0 - MIN_SAVING) * plain else None


def _plain(
    model: PlanningModel,
    start: Array,
    goal: Array,
    distance: float,
    bearing: float,
    speeds: tuple[float, float],
) -> float:
    """Return the energy of the line on which the heading changes at a constant rate [J]."""
    duration = max(distance / speeds[0], abs(goal[2] - start[2]) / speeds[1])
    fraction = (np.arange(4 * ROTATION_SAMPLES) + 0.5) / (4 * ROTATION_SAMPLES)
    headings = start[2] + fraction * (goal[2] - start[2])
    rate = (goal[2] - start[2]) / duration
    directions = bearing - headings[:, None] + _heading_errors()
    return float(power(model, _twists(distance / duration, directions, rate)).mean() * duration)


def _heading_errors() -> Array:
    """Return the heading errors (5,) [rad] over which power is averaged."""
    return HEADING_ERROR * np.linspace(-1.0, 1.0, 5)


def _twists(speed: float, directions: Array, rate: float | Array) -> Array:
    """Return body twists (..., 3) of a speed in directions (...) of base_link at a yaw rate."""
    rates = np.broadcast_to(rate, directions.shape)
    return np.stack([speed * np.cos(directions), speed * np.sin(directions), rates], axis=-1)


def _sign(speeds: Array) -> Array:
    """Return the sign of speeds (...), 0 for round-off."""
    result: Array = np.sign(np.where(np.abs(speeds) < 1e-9, 0.0, speeds))
    return result
