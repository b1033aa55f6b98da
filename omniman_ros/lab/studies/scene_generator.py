"""Random scenes to drive a robot through, each determined by its seed.

Scenes of even seeds always have a fixed obstacle on the straight line from start to goal. Of any
four consecutive seeds, two have a robot that differs from its model: one with an even seed and one
with an odd seed. Every third scene has a workspace.

Moving obstacles pass through each other and through fixed obstacles.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.core.planar import Triple
from omniman_ros.lab.studies.scene_geometry import (
    Area,
    Ellipse,
    PolylineMotion,
    RectangularOutline,
    ellipse_gaps,
)

AREA: Area = (0.0, 0.0, 8.0, 6.0)  #: contains start, goal, and all obstacles' centres at first [m]
ROBOT = RectangularOutline(0.8, 0.5)  #: default outline of the robot
OBSTACLE_COUNTS = (3, 8)  #: smallest and largest number of obstacles
SEMI_AXES = (0.1, 0.5)  #: range of the semi-axes of obstacles [m]
DISC_FRACTION = 0.5  #: probability that an obstacle is a disc
MOVING_FRACTION = 0.5  #: probability that an obstacle moves, unless drawn to block the way
SPEEDS = (0.1, 0.6)  #: range of the speeds of moving obstacles [m/s]
MIN_DISTANCE = 3.5  #: smallest distance from start to goal [m]
#: Smallest gap from obstacles to the robot at the start, and from fixed obstacles to the robot at
#: the goal [m].
MARGIN = 0.15
CLEAR_START_TIME = 1.0  #: time for which moving obstacles keep the margin to the start [s]
MAX_GOAL_STAY = 5.0  #: longest time of a moving obstacle nearer to the goal than the margin [s]
TURN_TIMES = (1.0, 8.0)  #: range of the times at which obstacles change their velocity [s]
#: Time for which obstacles bounce off the border of the area, and for which their stay at the goal
#: is checked; afterwards they move straight on [s].
MOTION_DURATION = 60.0
MAX_MISMATCH = 0.2  #: largest relative error of the model's mass, friction and motor constant
CHECK_PERIOD = 0.05  #: period of the samples at which moving obstacles are checked [s]
MAX_DRAWS = 2000  #: largest number of draws of a scene, and of obstacles in each draw


class SceneError(OmnimanError):
    """No scene that satisfies the constraints was found for a seed."""


@dataclass(frozen=True)
class Mismatch:
    """Ratios of the robot's true parameters to those of its model."""

    mass: float = 1.0  #: ratio of masses and inertias
    friction: float = 1.0  #: ratio of all friction
    motor_constant: float = 1.0  #: ratio of the torque constant, also the back-EMF constant


@dataclass(frozen=True)
class RandomScene:
    """A random scene: start, goal, obstacles, workspace and the robot's model mismatch."""

    seed: int  #: seed of the scene
    start: Triple  #: pose of the start in odom [m, m, rad]
    goal: Triple  #: pose of the goal in odom [m, m, rad]
    obstacles: tuple[Ellipse, ...]  #: obstacles as they truly move from time 0 on
    workspace: Area | None  #: workspace of the robot in odom [m]; None if it is unlimited
    blocked: bool  #: whether the straight line from start to goal leads through a fixed obstacle
    mismatch: Mismatch  #: mismatch between the true robot and its model


def scene(seed: int, box: RectangularOutline = ROBOT) -> RandomScene:
    """Return the scene of a seed, which is always the same for the same seed and box."""
    if seed < 0:
        raise InputError(f"the seed must not be negative, got {seed}")
    # The first number makes the random numbers differ from other uses of the same seeds.
    random = np.random.default_rng((20210, seed))
    for _ in range(MAX_DRAWS):
        made = _draw_scene(seed, box, random)
        if made is not None:
            return made
    raise SceneError(f"no scene was found for seed {seed} in {MAX_DRAWS} draws")


def blocks(obstacle: Ellipse, start: Triple, goal: Triple) -> bool:
    """Return whether the straight line from start to goal leads through an obstacle at time 0.

    The line connects the positions of the two poses.
    """
    x, y = obstacle.place(0.0).tolist()
    c, s = math.cos(obstacle.angle), math.sin(obstacle.angle)
    ends = np.array([(px - x, py - y) for px, py in (start[:2], goal[:2])])
    whitened = ends @ np.array([[c, -s], [s, c]]) / np.array(obstacle.semi_axes)
    chord = whitened[1] - whitened[0]
    fraction = min(max(-float(whitened[0] @ chord) / max(float(chord @ chord), 1e-12), 0.0), 1.0)
    return float(np.hypot(*(whitened[0] + fraction * chord))) <= 1.0


def _draw_scene(
    seed: int, box: RectangularOutline, random: np.random.Generator
) -> RandomScene | None:
    """Draw a scene; return None if this draw does not have enough room."""
    start, goal = _draw_pose(box, random), _draw_pose(box, random)
    if math.dist(start[:2], goal[:2]) < MIN_DISTANCE:
        return None
    count = int(random.integers(OBSTACLE_COUNTS[0], OBSTACLE_COUNTS[1] + 1))
    obstacles: list[Ellipse] = []
    if seed % 2 == 0:
        blocking = _draw_blocking_obstacle(start, goal, random)
        if not _leaves_room(blocking, start, goal, box):
            return None
        obstacles.append(blocking)
    for _ in range(MAX_DRAWS):
        if len(obstacles) == count:
            break
        obstacle = _draw_obstacle(random)
        if _leaves_room(obstacle, start, goal, box):
            obstacles.append(obstacle)
    else:
        return None
    factors = random.uniform(1.0 - MAX_MISMATCH, 1.0 + MAX_MISMATCH, 3).tolist()
    return RandomScene(
        seed,
        start,
        goal,
        tuple(obstacles),
        AREA if seed % 3 == 0 else None,
        any(o.is_fixed and blocks(o, start, goal) for o in obstacles),
        Mismatch(*factors) if seed // 2 % 2 == 0 else Mismatch(),
    )


def _draw_pose(box: RectangularOutline, random: np.random.Generator) -> Triple:
    """Draw a pose at which the box would keep `MARGIN` to the border at any heading."""
    room = box.radius + MARGIN
    x, y = (float(random.uniform(AREA[i] + room, AREA[i + 2] - room)) for i in (0, 1))
    return x, y, float(random.uniform(-math.pi, math.pi))


def _draw_shape(random: np.random.Generator) -> tuple[tuple[float, float], float]:
    """Draw the semi-axes [m] and the angle [rad] of an obstacle."""
    one, two = random.uniform(*SEMI_AXES, 2).tolist()
    if random.random() < DISC_FRACTION:
        return (one, one), 0.0
    return (one, two), float(random.uniform(-math.pi, math.pi))


def _draw_blocking_obstacle(start: Triple, goal: Triple, random: np.random.Generator) -> Ellipse:
    """Draw a fixed obstacle that the straight line from start to goal leads through.

    The distance of its centre from the line is less than its smaller semi-axis.
    """
    axes, angle = _draw_shape(random)
    line = np.subtract(goal[:2], start[:2])
    left = np.array([-line[1], line[0]]) / np.hypot(*line)
    offset = random.uniform(-0.9, 0.9) * min(axes)
    place = start[:2] + random.uniform(0.25, 0.75) * line + offset * left
    return Ellipse(axes, PolylineMotion.still(*place.tolist()), angle)


def _draw_obstacle(random: np.random.Generator) -> Ellipse:
    """Draw an obstacle that is fixed, moves straight, bounces off the border or turns once."""
    axes, angle = _draw_shape(random)
    x, y = (float(random.uniform(AREA[i], AREA[i + 2])) for i in (0, 1))
    if random.random() >= MOVING_FRACTION:
        return Ellipse(axes, PolylineMotion.still(x, y), angle)
    one, two = _draw_velocity(random), _draw_velocity(random)
    kind = int(random.integers(3))
    time = float(random.uniform(*TURN_TIMES))
    if kind == 0:
        motion = PolylineMotion.straight((x, y), one)
    elif kind == 1:
        motion = _bouncing((x, y), one)
    else:
        motion = PolylineMotion((0.0, time), ((x, y), (x + time * one[0], y + time * one[1])), two)
    return Ellipse(axes, motion, angle)


def _draw_velocity(random: np.random.Generator) -> tuple[float, float]:
    """Draw the velocity (x, y) of a moving obstacle [m/s]."""
    speed, direction = random.uniform(*SPEEDS), random.uniform(-math.pi, math.pi)
    return float(speed * math.cos(direction)), float(speed * math.sin(direction))


def _bouncing(place: tuple[float, float], velocity: tuple[float, float]) -> PolylineMotion:
    """Return the motion of an obstacle that bounces off the border of the area."""
    times, places = [0.0], [place]
    (x, y), (u, v) = place, velocity
    while times[-1] < MOTION_DURATION:
        ends = (AREA[2] if u > 0.0 else AREA[0], AREA[3] if v > 0.0 else AREA[1])
        until_border = [(ends[0] - x) / u if u else math.inf, (ends[1] - y) / v if v else math.inf]
        time = max(min(until_border), 1e-6)
        x, y = x + time * u, y + time * v
        if until_border[0] <= until_border[1]:
            u = -u
        else:
            v = -v
        times.append(times[-1] + time)
        places.append((x, y))
    return PolylineMotion(tuple(times), tuple(places), (u, v))


def _leaves_room(obstacle: Ellipse, start: Triple, goal: Triple, box: RectangularOutline) -> bool:
    """Return whether an obstacle leaves room for the robot at the start, and later at the goal."""
    if obstacle.is_fixed:
        gaps = _gaps(obstacle, np.array([start, goal]), np.zeros(2), box)
        return bool((gaps >= MARGIN).all())
    # Between two samples, it comes nearer by no more than its travel in half a period.
    slack = 0.5 * CHECK_PERIOD * obstacle.place.speed
    times = np.arange(0.0, CLEAR_START_TIME + 0.5 * CHECK_PERIOD, CHECK_PERIOD)
    if not (_gaps(obstacle, np.array([start]), times, box) >= MARGIN + slack).all():
        return False
    times = np.arange(0.0, MOTION_DURATION, CHECK_PERIOD)
    near = np.flatnonzero(_gaps(obstacle, np.array([goal]), times, box) < MARGIN + slack)
    stays = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
    return max(len(stay) for stay in stays) * CHECK_PERIOD <= MAX_GOAL_STAY


def _gaps(obstacle: Ellipse, poses: Array, times: Array, box: RectangularOutline) -> Array:
    """Return the gaps (N,) from an obstacle at times (N,) to the robot at (N, 3) or (1, 3)."""
    centers, axes = obstacle.place.at(times)[:, None], np.array([obstacle.semi_axes])
    gaps: Array = ellipse_gaps(poses, box, centers, axes, np.array([obstacle.angle]))[:, 0]
    return gaps
