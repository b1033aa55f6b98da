"""What driving takes, and in which heading a robot crosses open floor for the least energy.

Mecanum wheels take about as much along a roller diagonal as straight ahead, and up to twice as
much sideways: over a few metres it pays to turn first. Within its horizon of a second or two the
optimisation cannot see that; a route can.
"""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.planning.model import PlanningModel

Array = NDArray[np.float64]

WORTH = 0.07
"""Least share of the energy that a turn must save: smaller savings are lost in corrections."""
GENTLE = 0.7
"""Share of the limit on yaw rate at which the robot turns on its way."""
WOBBLE = math.radians(2.0)
"""A heading is held this well: along a diagonal a degree may cost a tenth [rad]."""
EVERY = 36
"""Headings that are tried."""
SAMPLES = 7
"""Of each turn."""


def power(model: PlanningModel, twists: Array) -> Array:
    """Electric power (...) [W] that holds body twists (..., 3).

    By the model's friction, with the least currents that balance it, MPC 2021 (21) to (24).
    """
    wheels, rollers = twists @ model.J.T, twists @ model.rolling.T
    at_wheels = model.viscous * wheels + model.coulomb * _sign(wheels)
    force = at_wheels @ model.J + (model.drag * _sign(rollers)) @ model.rolling
    currents = force @ np.linalg.pinv(model.J) / (model.efficiency * model.emf)
    result: Array = (model.voltages(currents, twists) * currents).sum(axis=-1)
    return result


def straight(
    model: PlanningModel, start: Array, goal: Array, speeds: tuple[float, float]
) -> Array:
    """Poses (K, 3) along a straight line, in the heading that takes the least energy.

    Args:
        model: The robot.
        start, goal: Poses [m, m, rad]; the goal's heading on the branch to arrive at.
        speeds: Linear [m/s] and angular [rad/s] speed on the way.
    """
    heading = _cruise(model, start, goal, speeds)
    if heading is None:
        return np.array([start, goal])
    ahead = goal[:2] - start[:2]
    distance = math.hypot(ahead[0], ahead[1])
    first = heading - start[2]
    last = goal[2] - heading
    lengths = np.array([0.0, abs(first), abs(last)]) * speeds[0] / (GENTLE * speeds[1])
    shares = np.array([0.0, lengths[1], distance - lengths[2], distance]) / distance
    headings = np.array([start[2], heading, heading, goal[2]])
    places = start[:2] + shares[:, None] * ahead
    return np.column_stack([places, headings])


def _cruise(
    model: PlanningModel, start: Array, goal: Array, speeds: tuple[float, float]
) -> float | None:
    """The heading that saves enough to be worth turning to [rad]; None if there is none."""
    ahead = goal[:2] - start[:2]
    distance, bearing = math.hypot(ahead[0], ahead[1]), math.atan2(ahead[1], ahead[0])
    speed, turning = speeds[0], GENTLE * speeds[1]
    around = np.arange(EVERY) * (math.tau / EVERY)
    middle = 0.5 * (start[2] + goal[2])
    headings = middle + np.array([se2.wrap(angle) for angle in bearing - around - middle])
    turns = np.abs(np.column_stack([headings - start[2], goal[2] - headings]))
    lengths = turns * (speed / turning)
    cruising = distance - lengths.sum(axis=1)
    fits = cruising > 0.0
    if not fits.any():
        return None
    headings, turns, lengths, cruising = (
        part[fits] for part in (headings, turns, lengths, cruising)
    )
    held = power(model, _twists(speed, bearing - headings[:, None] + _near(), 0.0)).mean(axis=1)
    energy = held * cruising / speed
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    for k, other in enumerate((start[2], goal[2])):
        between = other + share * (headings - other)[:, None]
        # The direction of the turn is that of the way: from the start on, towards the goal.
        signs = np.sign(headings - other) * (1.0 if k == 0 else -1.0)
        rate = turning * signs[:, None]
        while_turning = power(model, _twists(speed, bearing - between, rate)).mean(axis=1)
        spun = 0.5 * model.inertia[2, 2] * turning**2 / model.efficiency
        energy += while_turning * lengths[:, k] / speed + spun * np.minimum(turns[:, k] / 0.2, 1.0)
    plain = _plain(model, start, goal, distance, bearing, speeds)
    best = int(energy.argmin())
    return float(headings[best]) if energy[best] < (1.0 - WORTH) * plain else None


def _plain(
    model: PlanningModel,
    start: Array,
    goal: Array,
    distance: float,
    bearing: float,
    speeds: tuple[float, float],
) -> float:
    """Energy of the line on which the heading turns evenly [J]."""
    lasts = max(distance / speeds[0], abs(goal[2] - start[2]) / speeds[1])
    share = (np.arange(4 * SAMPLES) + 0.5) / (4 * SAMPLES)
    headings = start[2] + share * (goal[2] - start[2])
    rate = (goal[2] - start[2]) / lasts
    directions = bearing - headings[:, None] + _near()
    return float(power(model, _twists(distance / lasts, directions, rate)).mean() * lasts)


def _near() -> Array:
    return WOBBLE * np.linspace(-1.0, 1.0, 5)


def _twists(speed: float, directions: Array, rate: float | Array) -> Array:
    """Body twists (..., 3) of a speed into directions (...) of base_link, turning."""
    rates = np.broadcast_to(rate, directions.shape)
    return np.stack([speed * np.cos(directions), speed * np.sin(directions), rates], axis=-1)


def _sign(speeds: Array) -> Array:
    result: Array = np.sign(np.where(np.abs(speeds) < 1e-9, 0.0, speeds))
    return result
