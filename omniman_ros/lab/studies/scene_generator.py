"""Random scenes to drive a robot through, each determined by its seed.

Of any four consecutive seeds, two have a fixed obstacle on the straight line from start to goal,
and two have a robot that differs from its model, in all four combinations. Every third scene has
a workspace.

Moving obstacles pass through each other and through fixed ones.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.lab.studies.scene_gaps import ellipse_gap
from omniman_ros.lab.studies.scene_geometry import Area, Box, Ellipse, Route, World

Pose = tuple[float, float, float]

AREA: Area = (0.0, 0.0, 8.0, 6.0)
"""Area of start, goal and fixed obstacles, in which moving obstacles begin [m]."""
ROBOT = Box(0.8, 0.5)
"""Default outline of the robot."""
COUNT = (3, 8)
"""Least and largest number of obstacles."""
SEMI_AXES = (0.1, 0.5)
"""Range of the semi-axes of obstacles [m]."""
DISCS = 0.5
"""Share of obstacles that are discs."""
MOVING = 0.5
"""Share of obstacles that move, besides the fixed one that blocks the line."""
SPEEDS = (0.1, 0.6)
"""Range of the speeds of moving obstacles [m/s]."""
DISTANCE = 3.5
"""Least distance from start to goal [m]."""
MARGIN = 0.15
"""Least gap of obstacles to the robot at the start, and of fixed obstacles to the robot at the
goal [m]."""
CALM = 1.0
"""Time for which moving obstacles keep the margin to the start [s]."""
STAY = 5.0
"""Longest time for which a moving obstacle is nearer to the goal than the margin [s]."""
TURNS = (1.0, 8.0)
"""Range of the time at which an obstacle changes its velocity, if it does [s]."""
KNOWN = 60.0
"""Time for which the motion of obstacles is generated; afterwards they move straight on [s]."""
MISMATCH = 0.2
"""Largest relative error of the model's mass, friction and motor constant."""
SAMPLE = 0.05
"""Period at which moving obstacles are checked [s]."""
TRIES = 2000
"""Most draws of a scene, and most draws of its obstacles."""


class SceneError(OmnimanError):
    """No scene was found for a seed."""


@dataclass(frozen=True)
class Mismatch:
    """Ratios of the robot's true parameters to those of its model.

    Attributes:
        mass: Factor of mass and inertia.
        friction: Factor of all friction.
        motor_constant: Factor of torque and back-EMF constant.
    """

    mass: float = 1.0
    friction: float = 1.0
    motor_constant: float = 1.0


@dataclass(frozen=True)
class RandomScene:
    """A random scene.

    Attributes:
        seed: Seed of the scene.
        start: Pose of the start in odom [m, m, rad].
        goal: Pose of the goal in odom [m, m, rad].
        obstacles: Obstacles as they truly move, since time 0.
        workspace: x_min, y_min, x_max, y_max of the robot's workspace [m], or None.
        blocked: Whether the straight line from start to goal leads through a fixed obstacle.
        mismatch: Mismatch between the robot and its model.
    """

    seed: int
    start: Pose
    goal: Pose
    obstacles: tuple[Ellipse, ...]
    workspace: Area | None
    blocked: bool
    mismatch: Mismatch

    @property
    def world(self) -> World:
        """The obstacles and the workspace."""
        return World(self.obstacles, area=self.workspace)


def scene(seed: int, box: Box = ROBOT) -> RandomScene:
    """Make the scene of a seed, which is always the same for the same box.

    Args:
        seed: Seed, zero or more.
        box: The robot's outline.

    Raises:
        InputError: The seed is negative.
        SceneError: No scene with enough room was found.
    """
    if seed < 0:
        raise InputError(f"the seed must not be negative, got {seed}")
    # The first number keeps these apart from other uses of the same seeds.
    random = np.random.default_rng((20210, seed))
    for _ in range(TRIES):
        made = _try(seed, box, random)
        if made is not None:
            return made
    raise SceneError(f"no scene was found for seed {seed} in {TRIES} tries")


def blocks(obstacle: Ellipse, start: Pose, goal: Pose) -> bool:
    """Return whether an obstacle at time 0 lies on the line between the centres of two poses."""
    x, y = obstacle.place(0.0).tolist()
    c, s = math.cos(obstacle.angle), math.sin(obstacle.angle)
    ends = np.array([(px - x, py - y) for px, py in (start[:2], goal[:2])])
    whitened = ends @ np.array([[c, -s], [s, c]]) / np.array(obstacle.semi_axes)
    chord = whitened[1] - whitened[0]
    share = min(max(-float(whitened[0] @ chord) / max(float(chord @ chord), 1e-12), 0.0), 1.0)
    return float(np.hypot(*(whitened[0] + share * chord))) <= 1.0


def _try(seed: int, box: Box, random: np.random.Generator) -> RandomScene | None:
    """Draw a scene; return None if this draw has not enough room."""
    start, goal = _pose(box, random), _pose(box, random)
    if math.dist(start[:2], goal[:2]) < DISTANCE:
        return None
    count = int(random.integers(COUNT[0], COUNT[1] + 1))
    obstacles: list[Ellipse] = []
    if seed % 2 == 0:
        blocking = _on_line(start, goal, random)
        if not _allowed(blocking, start, goal, box):
            return None
        obstacles.append(blocking)
    for _ in range(TRIES):
        if len(obstacles) == count:
            break
        obstacle = _anywhere(random)
        if _allowed(obstacle, start, goal, box):
            obstacles.append(obstacle)
    else:
        return None
    factors = random.uniform(1.0 - MISMATCH, 1.0 + MISMATCH, 3).tolist()
    return RandomScene(
        seed,
        start,
        goal,
        tuple(obstacles),
        AREA if seed % 3 == 0 else None,
        any(o.fixed and blocks(o, start, goal) for o in obstacles),
        Mismatch(*factors) if seed // 2 % 2 == 0 else Mismatch(),
    )


def _pose(box: Box, random: np.random.Generator) -> Pose:
    """Draw a pose whose box is within the area at any heading."""
    room = box.radius + MARGIN
    x, y = (float(random.uniform(AREA[i] + room, AREA[i + 2] - room)) for i in (0, 1))
    return x, y, float(random.uniform(-math.pi, math.pi))


def _shape(random: np.random.Generator) -> tuple[tuple[float, float], float]:
    """Draw semi-axes [m] and angle [rad]."""
    one, two = random.uniform(*SEMI_AXES, 2).tolist()
    if random.random() < DISCS:
        return (one, one), 0.0
    return (one, two), float(random.uniform(-math.pi, math.pi))


def _on_line(start: Pose, goal: Pose, random: np.random.Generator) -> Ellipse:
    """Draw a fixed obstacle on the line, whose centre is off it by less than its extent."""
    axes, angle = _shape(random)
    line = np.subtract(goal[:2], start[:2])
    left = np.array([-line[1], line[0]]) / np.hypot(*line)
    off = random.uniform(-0.9, 0.9) * min(axes)
    place = start[:2] + random.uniform(0.25, 0.75) * line + off * left
    return Ellipse(axes, Route.still(*place.tolist()), angle)


def _anywhere(random: np.random.Generator) -> Ellipse:
    """Draw an obstacle that is fixed, moves straight, bounces in the area or turns once."""
    axes, angle = _shape(random)
    x, y = (float(random.uniform(AREA[i], AREA[i + 2])) for i in (0, 1))
    if random.random() >= MOVING:
        return Ellipse(axes, Route.still(x, y), angle)
    one, two = _velocity(random), _velocity(random)
    kind = int(random.integers(3))
    time = float(random.uniform(*TURNS))
    if kind == 0:
        route = Route.straight((x, y), one)
    elif kind == 1:
        route = _bouncing((x, y), one)
    else:
        route = Route((0.0, time), ((x, y), (x + time * one[0], y + time * one[1])), two)
    return Ellipse(axes, route, angle)


def _velocity(random: np.random.Generator) -> tuple[float, float]:
    speed, direction = random.uniform(*SPEEDS), random.uniform(-math.pi, math.pi)
    return float(speed * math.cos(direction)), float(speed * math.sin(direction))


def _bouncing(place: tuple[float, float], velocity: tuple[float, float]) -> Route:
    """Make a route that is reflected where the centre reaches the border of the area."""
    times, places = [0.0], [place]
    (x, y), (u, v) = place, velocity
    while times[-1] < KNOWN:
        ends = (AREA[2] if u > 0.0 else AREA[0], AREA[3] if v > 0.0 else AREA[1])
        left = [(ends[0] - x) / u if u else math.inf, (ends[1] - y) / v if v else math.inf]
        time = max(min(left), 1e-6)
        x, y = x + time * u, y + time * v
        if left[0] <= left[1]:
            u = -u
        else:
            v = -v
        times.append(times[-1] + time)
        places.append((x, y))
    return Route(tuple(times), tuple(places), (u, v))


def _allowed(obstacle: Ellipse, start: Pose, goal: Pose, box: Box) -> bool:
    """Return whether an obstacle leaves room for the robot at the start, and later at the goal."""
    if obstacle.fixed:
        gaps = _gaps(obstacle, np.array([start, goal]), np.zeros(2), box)
        return bool((gaps >= MARGIN).all())
    # Between two samples it comes nearer by no more than its travel in half a sample.
    slack = 0.5 * SAMPLE * obstacle.place.speed
    times = np.arange(0.0, CALM + 0.5 * SAMPLE, SAMPLE)
    if not (_gaps(obstacle, np.array([start]), times, box) >= MARGIN + slack).all():
        return False
    times = np.arange(0.0, KNOWN, SAMPLE)
    near = np.flatnonzero(_gaps(obstacle, np.array([goal]), times, box) < MARGIN + slack)
    stays = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
    return max(len(stay) for stay in stays) * SAMPLE <= STAY


def _gaps(obstacle: Ellipse, poses: Array, times: Array, box: Box) -> Array:
    """Return the gaps (N,) of an obstacle at times (N,) to the robot at poses (N, 3) or (1, 3)."""
    count = len(times)
    return ellipse_gap(
        np.broadcast_to(poses, (count, 3)),
        box,
        obstacle.place.at(times),
        np.tile(obstacle.semi_axes, (count, 1)),
        np.full(count, obstacle.angle),
    )
