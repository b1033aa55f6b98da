"""Search for the platform's way along the path of the tool, past what stands.

Dynamic programming over layers along the path: in each layer, the platform may be at positions
on a grid around the tool, with headings all around. The grid turns with the tool about the
vertical, so that the arm's posture at a point of the grid is the same wherever the tool has the
same height and tilt. Of all ways, one with the least sum of costs is found: of the arm's shape,
of narrow gaps, and of the platform's travel from layer to layer.

Where the tool's orientation is free, each point of the grid has the one with the best shape of the
arm, tilted only where that is needed. Along the way that is found, a second search chooses among
more of them, for the same costs and that of the change from layer to layer.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.body_spheres import PlacedSpheres
from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.signed_gaps import point_gap_values
from omniman_ros.collision.upright_obstacles import Mask, UprightObstacles
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.whole_body.model import planar_transform
from omniman_ros.motion.whole_body.redundancy_resolver import (
    CONFIGURATION_WEIGHTS,
    RedundancyResolver,
    describe_position,
)
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.planning.whole_body.body_gaps import BodyGaps, in_odom
from omniman_ros.planning.whole_body.coarse_gaps import CoarseGaps
from omniman_ros.planning.whole_body.free_orientation import FreeOrientation
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import PathSearchOptions
from omniman_ros.planning.whole_body.platform_path import NoPathError, PlatformPath
from omniman_ros.planning.whole_body.redundancy import (
    COORDINATES,
    PATH_PARAMETER,
    ToolRedundancy,
)

#: Largest horizontal distance of base_link from the tool that is tried [m]
MAX_TOOL_DISTANCE = 1.2
#: Largest change of the position on the grid, along each axis, and of the heading from layer to
#: layer [cells].
SHIFTS = 2
#: Change of the tool's height up to which postures are taken over from another layer [m]
SAME_HEIGHT = 0.03
SAME_TILT = 0.1  #: Change of the tool's tilt up to which postures are taken over [rad]
#: Length of the path whose surroundings are looked at together [m]: the area stays small
SECTION = 3.0
SHEET_END = 0.3  #: Distance that joints keep from half a revolution away from their start [rad]
LIMIT_RESERVE = 0.1  #: Distance that joints keep from their limits [rad]
SINGULARITY_RESERVE = 1.5  #: Margin to singularities relative to the least one
#: Numbers of rotations about a free axis, and of directions in which it tilts, for the platform's
#: way and along it
COARSE_ROTATIONS, FINE_ROTATIONS = (8, 4), (24, 8)
TILTED = 0.9  #: Free coordinate with which it tilts, over the half angle of the cone
FREE_COST = 0.3  #: Weight of a free orientation per layer, of 1 rad, relative to the arm's shape
FREE_TRAVEL = 6.0  #: Weight of its change from layer to layer [1/rad^2]
#: Largest change of a joint from layer to layer [rad]: one by more passes a joint's end, half a
#: revolution away from its start
JUMP = math.pi
OWN_GAP = 0.0  #: Gap between the spheres of the robot's parts, which are larger than these [m]

Choices = NDArray[np.int16]  #: Numbers of the steps from layer to layer, on the grid


@dataclass(frozen=True)
class _Configurations:
    """Points of the grid from which the arm reaches the tool, in the tool's upright frame."""

    cell: Indices  #: Their numbers (n,) on the grid
    pose: Array  #: Poses (n, 3) of base_link
    placed: PlacedSpheres  #: Spheres (n, S) in that frame
    cost: Array  #: Costs (n,) of the arm's shape


class PlatformPathSearch:
    """Finds ways of the platform, for a shape with few spheres and limits of the joints."""

    def __init__(
        self,
        redundancy: ToolRedundancy,
        path: ToolCurve,
        gaps: BodyGaps,
        resolver: RedundancyResolver,
        limits: AxisLimits,
        least_margin: float,
        options: PathSearchOptions,
    ) -> None:
        self.redundancy, self._path, self._gaps = redundancy, path, gaps
        self._resolver, self._options = resolver, options
        self._least_margin = SINGULARITY_RESERVE * least_margin
        centre = redundancy.centre
        self._signs = resolver.signs(centre)
        lower, upper = limits.lower[-6:] + LIMIT_RESERVE, limits.upper[-6:] - LIMIT_RESERVE
        room = math.pi - SHEET_END
        self._lower: Array = np.minimum(np.maximum(lower, centre - room), centre)
        self._upper: Array = np.maximum(np.minimum(upper, centre + room), centre)
        self._known: dict[tuple[int, ...], _Configurations] = {}
        self._rotations = self._free_rotations(np.zeros(1), COARSE_ROTATIONS)

    def find(self, start: Array, around: ObstacleSnapshot) -> PlatformPath:
        """Find a way from coordinates (4 + d,) to the end of the path, past what stands.

        Raises:
            NoPathError: There is none.
        """
        tried = [self._free_rotations(start[COORDINATES:], COARSE_ROTATIONS)]
        if len(tried[0]) > 1:  # else as if the orientation was held
            tried.append(np.zeros((1, len(start) - COORDINATES)))
        errors = list[NoPathError]()
        for self._rotations in tried:
            try:
                return self._way(start, around)
            except NoPathError as error:
                errors.append(error)
        raise errors[0]

    def _way(self, start: Array, around: ObstacleSnapshot) -> PlatformPath:
        """Return a way with one of `_rotations` at each place; see `find`."""
        o, path = self._options, self._path
        first = float(start[PATH_PARAMETER])
        count = max(3, math.ceil((path.end - first) / o.layer))
        places = np.linspace(first, path.end, count + 1)
        upright = path.at(places)[:, [0, 1, 3]]  # x, y and psi of the tool
        grid = _Grid(o, _relative(upright[0], start[:3]))
        self._known.clear()
        cost = np.full(grid.shape, np.inf)
        cost[grid.middle] = 0.0
        choices, gaps, section = [], [], math.ceil(SECTION / o.layer)
        for k in range(1, count + 1):
            if (k - 1) % section == 0:
                near = slice(k, k + section)
                coarse = self._coarse(grid, places[near], upright[near], around.standing)
            gaps.append(coarse)
            cost, choice = grid.moved(cost, upright[k - 1], upright[k])
            choices.append(choice)
            reached = np.isfinite(cost.ravel())
            at = self._configurations(grid, float(places[k]))
            price, block = self._priced(at, upright[k], coarse, around.standing, reached)
            cost = cost + price.reshape(grid.shape)
            if not np.isfinite(cost).any():
                found = _obstruction(float(places[k - 1]), block, around.labels())
                where = describe_position(path, float(places[k - 1]))
                raise NoPathError(f"{where}beyond it, {found.reason}", found)
        poses = _traced(grid, cost, choices, upright, start)
        if self.redundancy.free is not None:
            free = self._orientations(self.redundancy.free, start, poses, places, gaps)
            poses = np.hstack([poses, free])
        return PlatformPath(first, path.end, poses)

    def ends(self, start: Array, around: ObstacleSnapshot) -> Array:
        """Return poses (n, 3) of the platform, cheapest first, with the tool at the path's end.

        One of them is placed relative to the tool as the start (3,) is, if that is possible.

        Raises:
            NoPathError: There is none.
        """
        end = self._path.end
        first, last = self._path.at(np.array([0.0, end]))[:, [0, 1, 3]]
        grid = _Grid(self._options, _relative(first, start))
        everywhere = np.ones(len(grid.poses), dtype=bool)
        coarse = self._coarse(grid, np.array([end]), last[None], around.standing)
        at = self._configurations(grid, end)
        cost, block = self._priced(at, last, coarse, around.standing, everywhere)
        order = np.argsort(cost)[: np.isfinite(cost).sum()]
        if not len(order):
            found = _obstruction(end, block, around.labels())
            raise NoPathError(f"at the end of the path, {found.reason}", found)
        x, y, psi = last.tolist()
        return se2.displaced(grid.poses[order], (x, y, psi))

    def _coarse(
        self, grid: "_Grid", places: Array, upright: Array, standing: UprightObstacles
    ) -> CoarseGaps:
        """Return the gaps to what stands for layers at some places (n,) of the path [m]."""
        found = [self._configurations(grid, place) for place in places.tolist()]
        each = {id(configurations): configurations for configurations in found}.values()
        heights = np.concatenate([c.placed.centre[..., 2].ravel() for c in each])
        extent = max(float(np.hypot(c.pose[:, 0], c.pose[:, 1]).max(initial=0.0)) for c in each)
        # What is between base_link and the tool is no farther from the tool than base_link is.
        room = extent + self._gaps.radius + MAX_TOOL_DISTANCE
        return CoarseGaps(
            self._gaps,
            standing,
            upright[:, :2].min(axis=0) - room,
            upright[:, :2].max(axis=0) + room,
            (float(heights.min(initial=0.0)), float(heights.max(initial=0.0))),
            self._options.wide,
        )

    def _priced(
        self,
        at: _Configurations,
        upright: Array,
        coarse: CoarseGaps,
        standing: UprightObstacles,
        reached: Mask,
    ) -> tuple[Array, tuple[str, int] | None]:
        """Return the costs (n,) of all points of the grid in a layer.

        They are infinite where the robot cannot be, and where it does not come from the layer
        before (`reached`). The part and the obstacle that are in the way of the point with the
        widest gap come second. `upright` (3,) is x, y and psi of the tool.
        """
        o, result = self._options, np.full(len(reached), np.inf)
        chosen = np.flatnonzero(reached[at.cell])
        if not len(chosen):
            return result, None
        x, y, psi = upright.tolist()
        poses = se2.displaced(at.pose[chosen], (x, y, psi))
        gap = coarse.platform(poses)
        is_free = gap >= o.margin
        if not is_free.any():
            best = poses[[int(gap.argmax())]]
            nearest = int(self._gaps.platform(best, standing).argmin())
            return result, (self._gaps.names[0], nearest)
        chosen, gap = chosen[is_free], gap[is_free]
        frame = np.broadcast_to(upright, (len(chosen), 3))
        centre = np.moveaxis(in_odom(frame, at.placed.centre[chosen]), -1, 0)
        arm = coarse.arm(centre)
        gap = np.minimum(gap, arm)
        is_free = gap >= o.margin
        if not is_free.any():
            exact = point_gap_values(standing, centre[:, int(arm.argmax())])
            exact -= self._gaps.spheres.radius[:, None]
            sphere, nearest = divmod(int(exact.argmin()), len(standing))
            return result, (self._gaps.part_name(1 + sphere), nearest)
        chosen, gap = chosen[is_free], gap[is_free]
        narrow = np.maximum(o.wide - gap, 0.0) / o.wide
        result[at.cell[chosen]] = at.cost[chosen] + o.narrow * narrow**2
        return result, None

    def _configurations(self, grid: "_Grid", place: float) -> _Configurations:
        """Return the postures at a place of the path, perhaps those of a similar place."""
        path = self._path
        _, _, height, _, *tilt = path.at(np.array([place]))[0].tolist()
        key = (round(height / SAME_HEIGHT), *(round(angle / SAME_TILT) for angle in tilt))
        if key not in self._known:
            self._known[key] = self._found(grid, place)
        return self._known[key]

    def _found(self, grid: "_Grid", place: float) -> _Configurations:
        """Return all points of the grid from which the arm reaches the tool at a place."""
        path = self._path
        x, y, _, psi, *_ = path.at(np.array([place]))[0].tolist()
        tool = np.linalg.inv(planar_transform(np.array([x, y, psi]))) @ path.pose(
            np.array([place])
        )
        pose, count = grid.poses, len(grid.poses)
        least, postures = np.full(count, np.inf), np.empty((count, 6))
        for f in self._rotations:
            turned = self._turned(tool, f[None])
            near = np.flatnonzero(self._within_reach(pose, turned[0]))
            if f[1:].any():  # tilted only where that is needed
                near = near[np.isinf(least[near])]
            arm, cost = self._shaped(pose[near], np.broadcast_to(turned, (len(near), 4, 4)), f)
            is_better = cost < least[near]
            better = near[is_better]
            least[better], postures[better] = cost[is_better], arm[is_better]
        cell = np.flatnonzero(np.isfinite(least))
        pose, arm, cost = pose[cell], postures[cell], least[cell]
        placed = self._gaps.spheres.place(arm)
        is_apart = self._gaps.own(placed) >= OWN_GAP if len(cell) else np.zeros(0, dtype=bool)
        cell, pose, cost = cell[is_apart], pose[is_apart], cost[is_apart]
        centre = in_odom(pose, placed.centre[is_apart])
        return _Configurations(cell, pose, PlacedSpheres(centre, placed.frames[is_apart]), cost)

    def _shaped(self, pose: Array, tool: Array, f: Array) -> tuple[Array, Array]:
        """Return joint angles (n, 6) for poses (n, 3) and a tool (n, 4, 4), and their costs (n,).

        They are infinite where the arm cannot be. The tool is turned by free coordinates (d,) or
        (n, d).
        """
        arm = self.redundancy.arm(pose, tool)
        margins, _ = self._resolver.margins(arm, self._signs)
        is_possible = (margins >= self._least_margin).all(axis=1)
        is_possible &= ((arm >= self._lower) & (arm <= self._upper)).all(axis=1)
        difference = arm - self.redundancy.centre
        shape = (CONFIGURATION_WEIGHTS * difference**2).sum(axis=1)
        bound = self.redundancy.bound[COORDINATES:]
        turn = (FREE_COST / np.minimum(bound, 1.0) ** 2 * f * f).sum(axis=-1)
        cost = self._options.shape * (shape + turn)
        return arm, np.where(is_possible, cost, np.inf)

    def _turned(self, poses: Array, f: Array) -> Array:
        """Return poses (k, 4, 4) of the tool turned by free coordinates (k, d), if there are."""
        free = self.redundancy.free
        return poses if free is None else free.turned(poses, f)

    def _free_rotations(self, start: Array, counts: tuple[int, int]) -> Array:
        """Return free coordinates (n, d) that are tried, from those (d,) at the start on.

        The numbers are those of rotations about the axis and of directions of its tilt.
        """
        free = self.redundancy.free
        if free is None:
            return np.zeros((1, 0))
        steps = np.arange(counts[0]) - (counts[0] - 1) // 2  # half a revolution is the last
        about = start[0] + math.tau / counts[0] * steps
        tilt = np.zeros((1, len(free.bound) - 1))
        if tilt.shape[1]:
            angles = math.tau / counts[1] * np.arange(counts[1])
            ring = np.column_stack([np.cos(angles), np.sin(angles)])
            tilt = np.vstack([tilt, TILTED * free.cone * ring])
        return np.column_stack([np.tile(about, len(tilt)), np.repeat(tilt, len(about), axis=0)])

    def _orientations(
        self,
        free: FreeOrientation,
        start: Array,
        poses: Array,
        places: Array,
        gaps: list[CoarseGaps],
    ) -> Array:
        """Return free coordinates (n + 1, d) along a way, from those of the start (4 + d,) on.

        The way has poses (n + 1, 3) at places (n + 1,), and gaps to what stands from each layer to
        the next.

        Raises:
            NoPathError: There are none between which the joints go on steadily.
        """
        o, begin = self._options, start[COORDINATES:]
        tried = np.vstack([begin, self._free_rotations(begin, FINE_ROTATIONS)])
        change = tried[:, None] - tried
        travel = FREE_TRAVEL * (change * change).sum(axis=2)
        tools = self._path.pose(places)
        least, choices = np.where(travel[0] == 0.0, 0.0, np.inf), []
        before = self.redundancy.axes(start[None])[:, 3:]
        for k, coarse in enumerate(gaps, 1):
            pose = np.broadcast_to(poses[k], (len(tried), 3))
            tool = free.turned(np.broadcast_to(tools[k], (len(tried), 4, 4)), tried)
            arm, cost = self._shaped(pose, tool, tried)
            possible = np.flatnonzero(np.isfinite(cost))
            if len(possible):
                placed = self._gaps.spheres.place(arm[possible])
                centre = np.moveaxis(in_odom(pose[possible], placed.centre), -1, 0)
                gap = np.minimum(coarse.arm(centre), o.wide)
                cost[possible] += o.narrow * ((o.wide - gap) / o.wide) ** 2
                is_near = (gap < o.margin) | (self._gaps.own(placed) < OWN_GAP)
                cost[possible[is_near]] = np.inf
            jumps = np.abs(arm - before[:, None]).max(axis=2) > JUMP
            reached = np.where(jumps, np.inf, least[:, None] + travel)
            choices.append(reached.argmin(axis=0))
            least, before = reached.min(axis=0) + cost, arm
            if not np.isfinite(least).any():
                found = Obstruction(Cause.REACH, float(places[k]))
                where = describe_position(self._path, found.path_parameter)
                raise NoPathError(f"{where}{found.reason}", found)
        chosen = [int(least.argmin())]
        for choice in reversed(choices):
            chosen.append(int(choice[chosen[-1]]))
        return tried[chosen[::-1]]

    def _within_reach(self, pose: Array, tool: Array) -> Array:
        """Return which poses (n, 3) of the platform have the wrist within the arm's length."""
        model = self.redundancy.model
        t = model.arm.table
        base = model.base(pose)[:, :3, 3]
        wrist = tool[:3, 3] - t.d6 * tool[:3, 2]
        shoulder = base + [0.0, 0.0, t.d1]
        longest = abs(t.a2) + abs(t.a3) + t.d5 + abs(t.d4)
        distance = np.linalg.norm(wrist - shoulder, axis=1)
        result: Array = distance < longest
        return result


def _obstruction(
    place: float, block: tuple[str, int] | None, labels: tuple[str, ...]
) -> Obstruction:
    """Return what is in the way at a place of the path [m]: a part and an obstacle, or reach."""
    if block is None:
        return Obstruction(Cause.REACH, place)
    return Obstruction(Cause.STANDING, place, block[0], labels[block[1]])


class _Grid:
    """Positions and headings relative to the tool's upright frame; the start is one of them."""

    def __init__(self, options: PathSearchOptions, start: Array) -> None:
        self._options = options
        half = math.ceil(MAX_TOOL_DISTANCE / options.grid)
        lines = []
        for k in (0, 1):
            # The start is in the middle of a cell.
            offset = math.remainder(float(start[k]), options.grid)
            lines.append(offset + options.grid * np.arange(-half - 1, half + 2))
        self._turn = math.tau / options.headings
        heading = float(start[2]) + self._turn * np.arange(options.headings)
        self.x, self.y, self.heading = *lines, heading
        self.shape = len(lines[0]), len(lines[1]), options.headings
        self.middle = (
            int(np.abs(self.x - start[0]).argmin()),
            int(np.abs(self.y - start[1]).argmin()),
            0,
        )
        x, y, h = np.meshgrid(self.x, self.y, self.heading, indexing="ij")
        self.poses: Array = np.stack((x, y, h), axis=-1).reshape(-1, 3)

    def moved(self, cost: Array, before: Array, after: Array) -> tuple[Array, Choices]:
        """Return the least costs after a step from one layer to the next, and the choices.

        The frames before and after are x, y and psi (3,) of the tool.
        """
        o, span = self._options, 2 * SHIFTS + 1
        turn = float(after[2] - before[2])
        turned, by_heading = np.full(self.shape, np.inf), np.zeros(self.shape, dtype=np.int16)
        for k in range(-SHIFTS, SHIFTS + 1):
            shifted = np.roll(cost, k, axis=2) + o.turn * (k * self._turn + turn) ** 2
            is_less = shifted < turned
            np.copyto(turned, shifted, where=is_less)
            np.copyto(by_heading, k + SHIFTS, where=is_less)
        # Where a platform that stands would be in the next layer's frame.
        stay = _relative(after, _carried(before, np.zeros(3)))
        c, s = math.cos(stay[2]), math.sin(stay[2])
        x, y = np.meshgrid(self.x, self.y, indexing="ij")
        ex = x - (c * x - s * y + stay[0])
        ey = y - (s * x + c * y + stay[1])
        best, choice = np.full(self.shape, np.inf), np.zeros(self.shape, dtype=np.int16)
        for a in range(-SHIFTS, SHIFTS + 1):
            for b in range(-SHIFTS, SHIFTS + 1):
                travel = o.travel * ((ex + a * o.grid) ** 2 + (ey + b * o.grid) ** 2)
                to_x, from_x = _overlap(a, self.shape[0])
                to_y, from_y = _overlap(b, self.shape[1])
                tried = turned[from_x, from_y] + travel[from_x, from_y, None]
                target, chosen = best[to_x, to_y], choice[to_x, to_y]
                is_less = tried < target
                np.copyto(target, tried, where=is_less)
                code = np.int16(((a + SHIFTS) * span + b + SHIFTS) * span)
                np.copyto(chosen, by_heading[from_x, from_y] + code, where=is_less)
        return best, choice


def _overlap(shift: int, count: int) -> tuple[slice, slice]:
    """Return the slices of targets and sources of a shift along an axis."""
    return (
        slice(max(shift, 0), count + min(shift, 0)),
        slice(max(-shift, 0), count - max(shift, 0)),
    )


def _traced(
    grid: _Grid, cost: Array, choices: list[Choices], upright: Array, start: Array
) -> Array:
    """Return the poses (n + 1, 3) of the way with the least cost, headings going on."""
    span = 2 * SHIFTS + 1
    cell = np.array(np.unravel_index(int(cost.argmin()), grid.shape))
    relative = []
    for choice in reversed(choices):
        relative.append((grid.x[cell[0]], grid.y[cell[1]], grid.heading[cell[2]]))
        code = int(choice[tuple(cell)])
        shift = np.array([code // span**2, code // span % span, code % span]) - SHIFTS
        cell = cell - shift
        cell[2] %= grid.shape[2]
    poses = np.vstack(
        [
            start[:3],
            [_carried(at, np.array(r)) for at, r in zip(upright[1:], relative[::-1], strict=True)],
        ]
    )
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def _relative(frame: Array, pose: Array) -> Array:
    """Return a pose (3,) in a planar frame (3,)."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    x, y, yaw = (pose - frame).tolist()
    return np.array([c * x + s * y, c * y - s * x, yaw])


def _carried(frame: Array, pose: Array) -> Array:
    """Return the pose (3,) outside of a planar frame (3,) from that in it."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    x, y, yaw = pose.tolist()
    return np.array([frame[0] + c * x - s * y, frame[1] + s * x + c * y, frame[2] + yaw])
