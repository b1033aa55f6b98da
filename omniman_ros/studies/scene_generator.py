"""Random scenes to drive a robot through, each made from its seed alone.

Of any four seeds in a row two have the straight line from start to goal blocked by a fixed
obstacle and two have a robot that differs from its model, in all four combinations. Every third
scene has a workspace.

Moving obstacles know nothing of each other or of fixed ones: they go through them.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.studies.scene_geometry import (
    Area,
    Box,
    Ellipse,
    Route,
    World,
    ellipse_gap,
)

Array = NDArray[np.float64]
Pose = tuple[float, float, float]

AREA: Area = (0.0, 0.0, 8.0, 6.0)
"""Start, goal and fixed obstacles are in it; moving ones begin there [m]."""
ROBOT = Box(0.8, 0.5)
"""The robot for which scenes are made, unless told otherwise."""
COUNT = (3, 8)
"""Number of obstacles."""
SEMI_AXES = (0.1, 0.5)
"""Of obstacles [m]."""
DISCS = 0.5
"""Share of obstacles that are discs."""
MOVING = 0.5
"""Share of obstacles that move; the one that blocks the line stands."""
SPEEDS = (0.1, 0.6)
"""Of moving obstacles [m/s]."""
DISTANCE = 3.5
"""Least distance from start to goal [m]."""
MARGIN = 0.15
"""Least gap to the robot at the start, and of what stands at the goal [m]."""
CALM = 1.0
"""For so long moving obstacles keep the margin to the start [s]."""
STAY = 5.0
"""Moving obstacles are not nearer to the goal than the margin for longer [s]."""
TURNS = (1.0, 8.0)
"""When an obstacle changes its velocity, if it does [s]."""
KNOWN = 60.0
"""For so long the motion of obstacles is made; bouncing ones then go straight on [s]."""
MISMATCH = 0.2
"""The robot's mass, friction and motor constant differ from its model by up to this share."""
SAMPLE = 0.05
"""Of the times at which moving obstacles are checked [s]."""
TRIES = 2000


class SceneError(OmnimanError):
    """No scene was found for a seed."""


@dataclass(frozen=True)
class Mismatch:
    """What the robot's true parameters are of those of its model.

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
    """A drive to be made.

    Attributes:
        seed: What it was made from.
        start, goal: Poses in odom [m, m, rad].
        obstacles: As they truly move, since time 0.
        workspace: x_min, y_min, x_max, y_max that the robot is told to stay in [m], or None.
        blocked: Whether the straight line from start to goal goes through a fixed obstacle.
        mismatch: Of the robot and its model.
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
        """What the robot may touch, and where it has to stay."""
        return World(self.obstacles, area=self.workspace)


def scene(seed: int, box: Box = ROBOT) -> RandomScene:
    """Make the scene of a seed: always the same for the same box.

    Args:
        seed: Zero or more.
        box: The robot.

    Raises:
        InputError: The seed is negative.
        SceneError: There is no room.
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
    """Whether an obstacle, as it is at time 0, lies on the line between two poses' centres."""
    x, y = obstacle.place(0.0).tolist()
    c, s = math.cos(obstacle.angle), math.sin(obstacle.angle)
    ends = np.array([(px - x, py - y) for px, py in (start[:2], goal[:2])])
    turned = ends @ np.array([[c, -s], [s, c]]) / np.array(obstacle.semi_axes)
    way = turned[1] - turned[0]
    share = min(max(-float(turned[0] @ way) / max(float(way @ way), 1e-12), 0.0), 1.0)
    return float(np.hypot(*(turned[0] + share * way))) <= 1.0


def _try(seed: int, box: Box, random: np.random.Generator) -> RandomScene | None:
    """A scene, or None if this draw has no room."""
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
        seed, start, goal, tuple(obstacles), AREA if seed % 3 == 0 else None,
        any(o.fixed and blocks(o, start, goal) for o in obstacles),
        Mismatch(*factors) if seed // 2 % 2 == 0 else Mismatch(),
    )  # fmt: skip


def _pose(box: Box, random: np.random.Generator) -> Pose:
    """A pose with room to the border of the area, whatever the heading."""
    room = box.radius + MARGIN
    x, y = (float(random.uniform(AREA[i] + room, AREA[i + 2] - room)) for i in (0, 1))
    return x, y, float(random.uniform(-math.pi, math.pi))


def _shape(random: np.random.Generator) -> tuple[tuple[float, float], float]:
    """Semi-axes [m] and angle [rad]."""
    one, two = random.uniform(*SEMI_AXES, 2).tolist()
    if random.random() < DISCS:
        return (one, one), 0.0
    return (one, two), float(random.uniform(-math.pi, math.pi))


def _on_line(start: Pose, goal: Pose, random: np.random.Generator) -> Ellipse:
    """A fixed obstacle whose centre is nearly on the line: no farther off than it reaches."""
    axes, angle = _shape(random)
    way = np.subtract(goal[:2], start[:2])
    left = np.array([-way[1], way[0]]) / np.hypot(*way)
    off = random.uniform(-0.9, 0.9) * min(axes)
    place = start[:2] + random.uniform(0.25, 0.75) * way + off * left
    return Ellipse(axes, Route.still(*place.tolist()), angle)


def _anywhere(random: np.random.Generator) -> Ellipse:
    """An obstacle that stands, goes straight, bounces off the area or changes its velocity."""
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
    """Go straight and turn back, with the centre, where the area ends."""
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
    """Whether an obstacle leaves room for the robot at the start, and later at the goal."""
    if obstacle.fixed:
        gaps = _gaps(obstacle, np.array([start, goal]), np.zeros(2), box)
        return bool((gaps >= MARGIN).all())
    # It comes no nearer between two samples than its travel in half of one.
    slack = 0.5 * SAMPLE * obstacle.place.speed
    times = np.arange(0.0, CALM + 0.5 * SAMPLE, SAMPLE)
    if not (_gaps(obstacle, np.array([start]), times, box) >= MARGIN + slack).all():
        return False
    times = np.arange(0.0, KNOWN, SAMPLE)
    near = np.flatnonzero(_gaps(obstacle, np.array([goal]), times, box) < MARGIN + slack)
    stays = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
    return max(len(stay) for stay in stays) * SAMPLE <= STAY


def _gaps(obstacle: Ellipse, poses: Array, times: Array, box: Box) -> Array:
    """Gaps (N,) of an obstacle at times (N,) to the robot at poses (N, 3), or at one (1, 3)."""
    count = len(times)
    return ellipse_gap(
        np.broadcast_to(poses, (count, 3)), box, obstacle.place.at(times),
        np.tile(obstacle.semi_axes, (count, 1)), np.full(count, obstacle.angle),
    )  # fmt: skip
