"""Whether there is a way at all: an exhaustive search over x, y, heading and time.

It knows the true motion of everything and shares no code with the planner that it judges. The
robot is a box that translates in any direction at up to a speed and turns at up to a yaw rate;
its accelerations are not limited.

Which nodes of a grid over x, y and heading can be reached is known for a time; a step later, it
is these nodes, spread by what the robot can move in a step, without those too near to an
obstacle. A bit stands for a node, the bits of a word for its headings.

A way that is found is free of contact between the nodes too. Let q be how far any point of the
box travels in a step relative to an obstacle, and b = R delta^2 / 8 how far a turn by delta makes
it leave its chord, R being the distance of the corners. Nodes keep a gap m, larger than

* sqrt((r + b)^2 + (q / 2)^2) - r for an ellipse whose least radius of curvature is r. It is a
  smaller convex body with a disc of radius r rolled around it. The point of the box that comes
  nearest to a point of that body is r + m away from it at both ends, and moves at most q.
* the same with r = 0 for a wall, where the robot turns and drives in one step.
* l / sqrt(8) for a wall along which it drives by l and doesn't turn: what its centre must not
  enter holds a box of the robot's size around each of its points. A chord between two points that
  far from a right angle does not reach it; one across the box is longer than its width and 2 m.
* half the travel for a turn in place beside a wall.

What may be missed: ways with less to spare than the gap that nodes keep and what the grid rounds
off (`Grid.spare`), and ways that need more than 0.89 of the speed in some direction, or have to
turn as fast as they can while they drive along a wall.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError
from omniman_ros.studies.scene_geometry import (
    TOUCH,
    Area,
    Box,
    Ellipse,
    Wall,
    World,
    judge,
)

Array = NDArray[np.float64]
Words = NDArray[np.uint64]
Mask = NDArray[np.bool_]
Node = tuple[int, int, int]

SURROUNDINGS = 1.5
"""Without an area, ways are sought up to so far around start, goal and fixed obstacles [m]."""
STRIDE = math.sqrt(5.0)
"""Largest step [cells]: a knight's move, so that steps reach about equally far all around."""
NORMALS = 64
"""Of the polygon around what the robot's centre must not enter, beside those of box and wall."""
PART = 4
"""Moving obstacles are rounded to this part of a cell."""
KEPT = 32
"""Layers between two that are kept to find the way back."""
KICK = 4
"""A robot nearer to an obstacle than nodes may be gets away by a move of so many cells."""
SAFETY = 2.0 * TOUCH
"""Kept beside all else, so that the judge finds no contact [m]."""


@dataclass(frozen=True)
class Mover:
    """What the robot can do.

    Attributes:
        box: Its outline.
        speed: Largest, in any direction [m/s].
        yaw_rate: Largest [rad/s].

    Raises:
        InputError: A limit is not above zero and finite.
    """

    box: Box
    speed: float
    yaw_rate: float

    def __post_init__(self) -> None:
        for name in ("speed", "yaw_rate"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} must be above zero, got {getattr(self, name)}")


@dataclass(frozen=True)
class Grid:
    """How fine is searched.

    Attributes:
        cell: Distance of nodes [m].
        headings: In a full turn, 64 or 128.

    Raises:
        InputError: A value is refused.
    """

    cell: float
    headings: int

    def __post_init__(self) -> None:
        if not 0.0 < self.cell < math.inf:
            raise InputError(f"the cell must be above zero, got {self.cell} m")
        if self.headings not in (64, 128):
            raise InputError(f"headings must be 64 or 128, got {self.headings}")

    @property
    def angle(self) -> float:
        """Between two headings [rad]."""
        return math.tau / self.headings

    def step(self, mover: Mover) -> float:
        """Duration of a step [s]."""
        return max(STRIDE * self.cell / mover.speed, self.angle / mover.yaw_rate)

    def turn(self, mover: Mover) -> int:
        """Most headings that a step turns by."""
        return max(1, math.floor(mover.yaw_rate * self.step(mover) / self.angle + 1e-9))

    def bulge(self, mover: Mover) -> float:
        """How far a turn makes points of the box leave their chord [m]."""
        return mover.box.radius * (self.turn(mover) * self.angle) ** 2 / 8.0

    def kept_to_ellipse(self, mover: Mover, semi_axes: tuple[float, float], speed: float) -> float:
        """Gap that nodes keep to an ellipse of that speed [m]."""
        radius = min(semi_axes) ** 2 / max(semi_axes)
        rounding = math.sqrt(0.5) * self.cell / PART if speed > 0.0 else 0.0
        half = 0.5 * self._travel(mover, speed)
        return math.hypot(radius + self.bulge(mover), half) - radius + rounding + SAFETY

    def kept_to_wall(self, mover: Mover, turning: bool) -> float:
        """Gap that nodes keep to a wall [m], for steps that turn while they drive or don't."""
        if turning:
            return math.hypot(self.bulge(mover), 0.5 * self._travel(mover, 0.0)) + SAFETY
        in_place = 0.5 * mover.box.radius * self.turn(mover) * self.angle
        drive = mover.speed * self.step(mover)
        across = 0.5 * (drive - min(mover.box.length, mover.box.width))
        turn = math.hypot(self.bulge(mover), in_place)
        return max(drive / math.sqrt(8.0), across, turn) + SAFETY

    def spare(self, mover: Mover, kept: float) -> float:
        """Gap [m] with which a way among what stands is found, given the gap that nodes keep.

        The nearest node is half a cell off in x and y, and half an angle in heading. For what
        moves it is a guide: the search may need longer than the way, and be elsewhere.
        """
        return kept + math.sqrt(0.5) * self.cell + 0.5 * self.angle * mover.box.radius

    def _travel(self, mover: Mover, speed: float) -> float:
        """Largest distance of a point of the box's chord, as seen from an obstacle [m]."""
        drive = mover.speed * self.step(mover)
        turn = mover.box.radius * self.turn(mover) * self.angle
        return drive + turn + speed * self.step(mover)


GRIDS = (Grid(0.05, 64), Grid(0.025, 128))
"""Tried one after the other: most ways are found on the first, which takes a tenth of the time.

The second finds, for a robot of 0.8 m by 0.5 m at 1 m/s and 2 rad/s, what has to spare: 3.4 cm
from standing discs of 0.3 m radius, 4.2 cm from those that move at 0.6 m/s, 5.3 cm from walls.
"""
FINE = (*GRIDS, Grid(0.0125, 128))
"""For ways with little to spare, 3.2 cm from walls and 2.5 cm from moving discs for that robot.

Where the others find none, it takes some eight times as long.
"""


@dataclass(frozen=True)
class Way:
    """A way: straight at constant speeds from each pose to the next.

    Attributes:
        times: (K,) [s].
        poses: (K, 3) in odom [m, m, rad], headings not wrapped.
    """

    times: Array
    poses: Array

    @property
    def speeds(self) -> tuple[float, float]:
        """Largest speed [m/s] and yaw rate [rad/s]."""
        steps = np.abs(np.diff(self.poses, axis=0)) / np.diff(self.times)[:, None]
        drive = np.hypot(steps[:, 0], steps[:, 1])
        return float(drive.max(initial=0.0)), float(steps[:, 2].max(initial=0.0))


def find_way(
    mover: Mover,
    world: World,
    start: Sequence[float],
    goal: Sequence[float],
    since: float,
    until: float,
    grids: Sequence[Grid] = GRIDS,
) -> Way | None:
    """Find a way from start to goal without contact.

    Args:
        mover: The robot.
        world: What is there. All of the robot stays in its area; without one, its centre stays
            within `SURROUNDINGS`.
        start: (3,) pose at the time `since` [m, m, rad].
        goal: (3,) pose to reach at any time up to `until` [m, m, rad].
        since, until: [s].
        grids: Tried in turn.

    Returns:
        The way, its last pose the goal; None if none was found.

    Raises:
        InputError: A pose or time is refused.
    """
    begin, end = _pose("start", start), _pose("goal", goal)
    _span(since, until)
    places = [begin[:2], end[:2]] + [o.place(since) for o in world.obstacles if o.fixed]
    places += [np.array((w.x, w.y)) + s for w in world.walls for s in _corners(w)]
    low, high = np.min(places, axis=0) - SURROUNDINGS, np.max(places, axis=0) + SURROUNDINGS
    # Fixed things at the goal rule it out at once, at any time.
    fixed = World(tuple(o for o in world.obstacles if o.fixed), world.walls, world.area)
    for pose in (begin, end):
        verdict = judge(np.array([since]), pose[None], mover.box, fixed)
        if verdict.collided or verdict.outside > 0.0:
            return None
    for grid in grids:
        search = _Search(mover, world, begin, since, until, grid, (*low, *high))
        way = search.run(end)
        if way is not None:
            return way
    return None


def escape(
    mover: Mover,
    world: World,
    start: Sequence[float],
    since: float,
    until: float,
    grids: Sequence[Grid] = GRIDS,
) -> Way | None:
    """Find a way to touch nothing from a pose at a time until another time.

    Args:
        mover: The robot.
        world: What is there. All of the robot stays in its area, if there is one: none who is
            not in it escapes.
        start: (3,) pose at the time `since` [m, m, rad].
        since, until: [s].
        grids: Tried in turn.

    Returns:
        The way; None if none was found.

    Raises:
        InputError: The pose or a time is refused.
    """
    begin = _pose("start", start)
    _span(since, until)
    if judge(np.array([since]), begin[None], mover.box, world).collided:
        return None
    reach = mover.speed * (until - since) + 1.0
    bounds = (begin[0] - reach, begin[1] - reach, begin[0] + reach, begin[1] + reach)
    for grid in grids:
        way = _Search(mover, world, begin, since, until, grid, bounds).run()
        if way is not None:
            return way
    return None


def avoidable(
    mover: Mover,
    world: World,
    times: Array,
    poses: Array,
    contact: float,
    before: float = 2.0,
    after: float = 1.0,
    grids: Sequence[Grid] = GRIDS,
) -> Way | None:
    """Find how a contact could have been avoided by a robot that knew what was to come.

    Its velocity at the time is not regarded, as accelerations are not limited: lower the mover's
    speed to allow for braking.

    Args:
        mover: The robot.
        world: What is there.
        times: (K,) of a drive [s], increasing.
        poses: (K, 3) true poses of the drive in odom [m, m, rad].
        contact: When the drive's first contact was [s].
        before: How long before the contact the search begins, or with the drive if that is later.
        after: For how long after the contact nothing may be touched either [s].
        grids: Tried in turn.

    Returns:
        A way out; None if none was found: the contact then is not the robot's fault.

    Raises:
        InputError: The contact is not within the drive, or a value is refused.
    """
    if not times[0] <= contact <= times[-1]:
        raise InputError(f"the contact at {contact} s is not within the drive, {times[0]} to "
                         f"{times[-1]} s")  # fmt: skip
    since = max(contact - before, float(times[0]))
    headings = np.unwrap(poses[:, 2])
    pose = [float(np.interp(since, times, i)) for i in (poses[:, 0], poses[:, 1], headings)]
    return escape(mover, world, pose, since, contact + after, grids)


def _pose(name: str, pose: Sequence[float]) -> Array:
    result = np.array(pose, dtype=float)
    if result.shape != (3,) or not np.isfinite(result).all():
        raise InputError(f"the {name} must be a finite x, y, heading, got {pose}")
    return result


def _span(since: float, until: float) -> None:
    if not (math.isfinite(since) and math.isfinite(until) and since < until):
        raise InputError(f"a search needs a time to end after its begin, got {since} to {until} s")


def _corners(wall: Wall) -> list[Array]:
    c, s = math.cos(wall.heading), math.sin(wall.heading)
    along, across = 0.5 * wall.length, 0.5 * wall.width
    return [np.array((i * along * c - j * across * s, i * along * s + j * across * c))
            for i in (-1, 1) for j in (-1, 1)]  # fmt: skip


# ---- where the robot's centre must not be -------------------------------------------------------


def _blocked(body: Ellipse | Wall, box: Box, headings: Array, margin: float,
             xs: Array, ys: Array) -> Mask:  # fmt: skip
    """Where (Y, X, H) the box would be nearer than a margin to a body [m], by heading (H,).

    The places xs (X,), ys (Y,) are relative to the body's centre. It is a convex region, here
    taken as the polygon of its tangents, which holds it.
    """
    if isinstance(body, Ellipse):
        (along, across), turn = body.semi_axes, body.angle
    else:
        along, across, turn = 0.5 * body.length, 0.5 * body.width, body.heading
    right = np.arange(4) * 0.5 * math.pi
    angles = np.arange(NORMALS) * math.tau / NORMALS
    if isinstance(body, Wall):
        angles = np.concatenate((angles, turn + right))
    angles = np.concatenate(
        (np.tile(angles, (len(headings), 1)), headings[:, None] + right), axis=1
    )
    nx, ny = np.cos(angles), np.sin(angles)
    to_box, to_body = angles - headings[:, None], angles - turn
    reach = box.half[0] * np.abs(np.cos(to_box)) + box.half[1] * np.abs(np.sin(to_box)) + margin
    if isinstance(body, Ellipse):
        reach += np.hypot(along * np.cos(to_body), across * np.sin(to_body))
    else:
        reach += along * np.abs(np.cos(to_body)) + across * np.abs(np.sin(to_body))
    upright = np.abs(nx) < 1e-9
    room = reach[:, None] - ys[:, None] * ny[:, None]  # (H, Y, normals)
    border = room / np.where(upright, 1.0, nx)[:, None]
    last = np.where((nx >= 1e-9)[:, None], border, np.inf).min(axis=2)
    first = np.where((nx <= -1e-9)[:, None], border, -np.inf).max(axis=2)
    beyond = (upright[:, None] & (room <= 0.0)).any(axis=2)
    last[beyond] = -np.inf
    result: Mask = (xs[:, None] > first.T[:, None]) & (xs[:, None] < last.T[:, None])
    return result


def _packed(blocked: Mask, headings: int) -> Words:
    """Words (Y, X) with a bit set where half a turn of headings (Y, X, H) is free.

    A box turned by half a turn is itself: of 128 headings, both words are the same.
    """
    free = np.concatenate((~blocked, ~blocked), axis=2) if headings == 64 else ~blocked
    words: Words = np.packbits(free, axis=2, bitorder="little").view("<u8")[..., 0]
    return words.astype(np.uint64)


class _Moving:
    """A moving obstacle as seen from the layers of a search."""

    def __init__(self, search: "_Search", body: Ellipse) -> None:
        grid, mover = search.grid, search.mover
        speed = body.place.speed
        self.part = grid.cell / PART
        margin = grid.kept_to_ellipse(mover, body.semi_axes, speed)
        # Where it changes its velocity within a step, it leaves its chord by half its travel.
        margins = (margin, margin + 0.5 * speed * search.step)
        farthest = mover.box.radius + max(body.semi_axes) + margins[1]
        self.size = math.ceil(farthest / self.part)
        places = body.place.at(search.times)
        self.places = np.round((places - search.origin) / self.part).astype(int)
        self.bent = np.zeros(len(search.times), dtype=bool)
        for knot in body.place.times:
            first = int(np.searchsorted(search.times, knot)) - 1
            if 0 <= first < len(self.bent):
                self.bent[first : first + 2] = True
        offsets: Array = self.part * np.arange(-self.size, self.size + 1, dtype=float)
        self._blocked = partial(
            _blocked, body, mover.box, search.half_turn, xs=offsets, ys=offsets
        )
        self._headings = grid.headings
        self._margins = margins
        self._free: dict[bool, Words] = {}

    def mask(self, state: Words, layer: int) -> None:
        """Take the nodes out of a layer that are too near."""
        bent = bool(self.bent[layer])
        if bent not in self._free:
            blocked = self._blocked(margin=self._margins[bent])
            self._free[bent] = _packed(blocked, self._headings)
        slices, cut = [], []
        for place, count in zip(self.places[layer].tolist(), state.shape[:0:-1], strict=True):
            first = max(-((self.size - place) // PART), 0)
            last = min((place + self.size) // PART, count - 1)
            if last < first:
                return
            slices.append(slice(first, last + 1))
            begin = first * PART - place + self.size
            cut.append(slice(begin, begin + (last - first) * PART + 1, PART))
        state[:, slices[1], slices[0]] &= self._free[bent][cut[1], cut[0]]


# ---- the search ---------------------------------------------------------------------------------


class _Search:
    """What can be reached from a pose, on one grid: the start is one of its nodes.

    States are words (W, Y, X); around them lies a border of nodes that are never free.
    """

    def __init__(
        self,
        mover: Mover,
        world: World,
        start: Array,
        since: float,
        until: float,
        grid: Grid,
        bounds: Area,
    ) -> None:
        self.mover, self.world, self.grid, self.start = mover, world, grid, start
        self.step, self.turn, self.until = grid.step(mover), grid.turn(mover), until
        count = math.ceil((until - since) / self.step - 1e-9)
        self.times: Array = since + self.step * np.arange(count + 1, dtype=float)
        self.widths = self._element()
        self.reach = len(self.widths) - 1

        area = bounds if world.area is None else world.area
        far = mover.speed * (until - since)
        low = np.maximum(np.array(area[:2]) - start[:2], -far) / grid.cell
        high = np.minimum(np.array(area[2:]) - start[:2], far) / grid.cell
        first = np.floor(np.minimum(low, 0.0)).astype(int) - self.reach - 1
        last = np.ceil(np.maximum(high, 0.0)).astype(int) + self.reach + 1
        self.origin = start[:2] + grid.cell * first
        columns, rows = (last - first + 1).tolist()
        self.shape = (grid.headings // 64, rows, columns)
        self.home: Node = (0, -int(first[1]), -int(first[0]))
        half = grid.headings // 2
        self.half_turn = start[2] + grid.angle * np.arange(half)
        self.xs = self.origin[0] + grid.cell * np.arange(columns)
        self.ys = self.origin[1] + grid.cell * np.arange(rows)

        self.free = self._static(turning=False)
        self.turning = self._static(turning=True) if world.walls else self.free
        self.moving = [_Moving(self, o) for o in world.obstacles if not o.fixed]
        self.seeds: dict[int, set[Node]] = {}
        self._seed()

    # -- nodes

    def pose(self, node: Node) -> Array:
        """Pose (3,) of a node, its heading as near to zero turns from the start as may be."""
        heading, row, column = node
        turn = (heading + self.grid.headings // 2) % self.grid.headings - self.grid.headings // 2
        return np.array([self.xs[column], self.ys[row], self.start[2] + self.grid.angle * turn])

    @staticmethod
    def has(state: Words, node: Node) -> bool:
        """Whether a node is in a state."""
        heading, row, column = node
        return bool(int(state[heading // 64, row, column]) >> (heading % 64) & 1)

    @staticmethod
    def _put(state: Words, node: Node) -> None:
        heading, row, column = node
        state[heading // 64, row, column] |= np.uint64(1 << (heading % 64))

    def _static(self, turning: bool) -> Words:
        """Nodes (Y, X) that are free of what stands, and within the area."""
        grid, box = self.grid, self.mover.box
        c, s = np.abs(np.cos(self.half_turn)), np.abs(np.sin(self.half_turn))
        blocked = np.zeros((len(self.ys), len(self.xs), len(self.half_turn)), dtype=bool)
        border = self.reach
        if self.world.area is not None:
            edge = SAFETY + grid.bulge(self.mover)
            wide = box.half[0] * c + box.half[1] * s + edge
            high = box.half[0] * s + box.half[1] * c + edge
            x_min, y_min, x_max, y_max = self.world.area
            xs, ys = self.xs[:, None], self.ys[:, None]
            blocked |= (xs < x_min + wide) | (xs > x_max - wide)
            blocked |= ((ys < y_min + high) | (ys > y_max - high))[:, None]
        bodies: tuple[Ellipse | Wall, ...] = (*self.world.obstacles, *self.world.walls)
        for body in bodies:
            if isinstance(body, Wall):
                center = np.array((body.x, body.y))
                size = 0.5 * math.hypot(body.length, body.width)
                margin = grid.kept_to_wall(self.mover, turning)
            elif body.fixed:
                center, size = body.place(0.0), max(body.semi_axes)
                margin = grid.kept_to_ellipse(self.mover, body.semi_axes, 0.0)
            else:
                continue
            far = size + box.radius + margin
            columns = slice(*np.searchsorted(self.xs, (center[0] - far, center[0] + far)))
            rows = slice(*np.searchsorted(self.ys, (center[1] - far, center[1] + far)))
            xs, ys = self.xs[columns] - center[0], self.ys[rows] - center[1]
            if len(xs) and len(ys):
                blocked[rows, columns] |= _blocked(body, box, self.half_turn, margin, xs, ys)
        blocked[:border] = blocked[-border:] = True
        blocked[:, :border] = blocked[:, -border:] = True
        return _packed(blocked, grid.headings)

    def _seed(self) -> None:
        """Nodes from which the search begins: the start or, too near to something, around it."""
        at_home = np.zeros(self.shape, dtype=np.uint64)
        self._put(at_home, self.home)
        if self._free_at(at_home, 0).any():
            self.seeds[0] = {self.home}
            return
        everywhere: dict[int, Words] = {}
        _, row, column = self.home
        size = range(-KICK, KICK + 1)
        turns = range(-2, 3)
        kicks = [(i, j, k) for i in size for j in size for k in turns if i * i + j * j <= KICK**2]
        for i, j, k in kicks:
            drive = math.hypot(i, j) * self.grid.cell / self.mover.speed
            turn = abs(k) * self.grid.angle / self.mover.yaw_rate
            layer = max(math.ceil(max(drive, turn) / self.step - 1e-9), 1)
            node = (k % self.grid.headings, row + i, column + j)
            if layer >= len(self.times) or not (
                0 <= node[1] < self.shape[1] and 0 <= node[2] < self.shape[2]
            ):
                continue
            if layer not in everywhere:
                full = np.full(self.shape, ~np.uint64(0), dtype=np.uint64)
                everywhere[layer] = self._free_at(full, layer)
            if self.has(everywhere[layer], node) and self._clear(
                np.array([self.times[0], self.times[layer]]),
                np.stack((self.start, self.pose(node))),
            ):
                self.seeds.setdefault(layer, set()).add(node)

    def _free_at(self, state: Words, layer: int) -> Words:
        """What of a state is free in a layer."""
        result: Words = state & self.free
        for obstacle in self.moving:
            obstacle.mask(result, layer)
        return result

    def _clear(self, times: Array, poses: Array) -> bool:
        """Whether a move touches nothing and stays in the area, exactly."""
        verdict = judge(times, poses, self.mover.box, self.world)
        return not verdict.collided and verdict.outside <= 0.0

    # -- steps

    def _element(self) -> list[int]:
        """How far (cells) a step goes in x at most, for each distance in y from 0 on."""
        far = self.mover.speed * self.step / self.grid.cell + 1e-9
        return [math.floor(math.sqrt(far * far - i * i)) for i in range(math.floor(far) + 1)]

    def _driven(self, state: Words, rows: slice, columns: slice) -> Words:
        """What drives of a step reach of a window."""
        reach, count = self.reach, rows.stop - rows.start
        high = slice(rows.start - reach, rows.stop + reach)
        wide = state[:, high, columns].copy()
        spread = [wide]
        for i in range(1, max(self.widths) + 1):
            wide = wide | state[:, high, columns.start - i : columns.stop - i]
            wide |= state[:, high, columns.start + i : columns.stop + i]
            spread.append(wide)
        result: Words = spread[self.widths[0]][:, reach : reach + count].copy()
        for i in range(1, reach + 1):
            source = spread[self.widths[i]]
            result |= source[:, reach - i : reach - i + count]
            result |= source[:, reach + i : reach + i + count]
        return result

    def _turned(self, state: Words) -> Words:
        """What turns of a step reach, without those that stay."""
        one, top = np.uint64(1), np.uint64(63)
        result = np.zeros_like(state)
        left = right = state
        for _ in range(self.turn):
            left = (left << one) | (np.roll(left, 1, axis=0) >> top)
            right = (right >> one) | (np.roll(right, -1, axis=0) << top)
            result |= left
            result |= right
        return result

    def _advance(self, state: Words, layer: int) -> Words:
        """The state a layer after a state."""
        result = np.zeros_like(state)
        _, row, column = self.home
        far, edge = self.reach * (layer + 1) + KICK, self.reach
        rows = slice(max(row - far, edge), min(row + far + 1, self.shape[1] - edge))
        columns = slice(max(column - far, edge), min(column + far + 1, self.shape[2] - edge))
        driven = self._driven(state, rows, columns)
        free, turning = self.free[rows, columns], self.turning[rows, columns]
        window = result[:, rows, columns]
        if self.turning is self.free:
            np.bitwise_or(driven, self._turned(driven), out=window)
            window &= free
        else:
            np.bitwise_or(driven, self._turned(state[:, rows, columns]), out=window)
            window &= free
            both = self._turned(self._driven(state & self.turning, rows, columns))
            both &= turning
            window |= both
        for obstacle in self.moving:
            obstacle.mask(result, layer + 1)
        for node in self.seeds.get(layer + 1, ()):
            self._put(result, node)
        return result

    # -- ways

    def run(self, goal: Array | None = None) -> Way | None:
        """Search until a goal (3,) is reached or, without one, until the last layer."""
        if not self.seeds:
            return None
        state = np.zeros(self.shape, dtype=np.uint64)
        for node in self.seeds.get(0, ()):
            self._put(state, node)
        kept = {0: state}
        last = len(self.times) - 1
        for layer in range(last + 1):
            if layer:
                before, state = state, self._advance(state, layer - 1)
                if layer % KEPT == 0:
                    kept[layer] = state
                if layer > max(self.seeds):
                    if not state.any():
                        return None
                    if goal is not None and not self.moving and np.array_equal(before, state):
                        return None
            end = None if goal is None else self._arrived(layer, state, goal)
            if end is not None:
                return self._back(kept, layer, *end)
        if goal is not None or not state.any():
            return None
        word, row, column = (int(i[0]) for i in np.nonzero(state))
        bits = int(state[word, row, column])
        node = (64 * word + (bits & -bits).bit_length() - 1, row, column)
        return self._back(kept, last, node, Way(np.empty(0), np.empty((0, 3))))

    def _arrived(self, layer: int, state: Words, goal: Array) -> tuple[Node, Way] | None:
        """The last node before the goal and the move to it, if there is one in a layer."""
        grid, now = self.grid, float(self.times[layer])
        turns = (goal[2] - self.start[2]) / grid.angle
        column, row = ((goal[:2] - self.origin) / grid.cell).tolist()
        nodes = [
            (i % grid.headings, j, k)
            for i in {math.floor(turns), math.ceil(turns)}
            for j in {math.floor(row), math.ceil(row)}
            for k in {math.floor(column), math.ceil(column)}
            if 0 <= j < self.shape[1] and 0 <= k < self.shape[2]
        ]
        for node in nodes:
            if not self.has(state, node):
                continue
            pose = self.pose(node)
            end = goal.copy()
            end[2] = pose[2] + math.remainder(goal[2] - pose[2], math.tau)
            move = np.abs(end - pose)
            spent = max(math.hypot(*move[:2]) / self.mover.speed, move[2] / self.mover.yaw_rate)
            if spent < 1e-9:
                return node, Way(np.empty(0), np.empty((0, 3)))
            times = np.array([now, now + spent])
            if times[1] <= self.until + 1e-9 and self._clear(times, np.stack((pose, end))):
                return node, Way(times[1:], end[None])
        return None

    def _back(self, kept: dict[int, Words], layer: int, node: Node, tail: Way) -> Way:
        """The way to a node of a layer, and on."""
        nodes, layers = [node], [layer]
        block: list[Words] = []
        begin = layer + 1
        while layer > 0 and node not in self.seeds.get(layer, ()):
            layer -= 1
            if layer < begin:  # layers since the last one kept are made again
                top, begin = layer, layer - layer % KEPT
                block = [kept[begin]]
                for i in range(begin, top):
                    block.append(self._advance(block[-1], i))
            node = self._before(block[layer - begin], node)
            nodes.append(node)
            layers.append(layer)
        times: Array = self.times[layers[::-1]]
        poses = np.array([self.pose(n) for n in nodes[::-1]])
        if layers[-1] > 0:  # a move from beside the grid's free nodes
            times = np.concatenate((self.times[:1], times))
            poses = np.concatenate((self.start[None], poses))
        times, poses = np.concatenate((times, tail.times)), np.concatenate((poses, tail.poses))
        poses[:, 2] = np.unwrap(poses[:, 2])
        return Way(times, poses)

    def _before(self, state: Words, node: Node) -> Node:
        """A node of a state from which a step leads to a node: the one with the least motion."""
        heading, row, column = node
        moves = [
            (i, j)
            for i in range(-self.reach, self.reach + 1)
            for j in range(-self.widths[abs(i)], self.widths[abs(i)] + 1)
        ]
        moves.sort(key=lambda move: move[0] ** 2 + move[1] ** 2)
        for turn in sorted(range(-self.turn, self.turn + 1), key=abs):
            for i, j in moves:
                before = ((heading + turn) % self.grid.headings, row + i, column + j)
                if self.has(state, before) and (
                    turn == 0 or (i, j) == (0, 0) or self._may_turn(before, node)
                ):
                    return before
        raise AssertionError(f"node {node} was reached from nowhere")

    def _may_turn(self, *nodes: Node) -> bool:
        """Whether a step may turn and drive between two nodes."""
        return all(
            int(self.turning[row, column]) >> (heading % 64) & 1 for heading, row, column in nodes
        )
