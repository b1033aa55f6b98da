"""Goals of the joints with the platform: a pose of the platform and joint angles, together.

The joints go along a straight line. The platform drives a route over (x, y, heading), with an
outline of the robot that contains all postures on the line; the arm moves on the way. Where that
has no room, the arm moves before the route, or after it. Each way is checked as the plans on it
are before it is followed.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.se2 import wrap
from omniman_ros.motion.axes import AXES, HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.whole_body.body_balance import BodyBalance
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.carried_route import CarriedRoutes
from omniman_ros.planning.whole_body.controller import OBSTACLE_CUTOFF
from omniman_ros.planning.whole_body.joint_redundancy import JointPath, JointRedundancy
from omniman_ros.planning.whole_body.linearisation import (
    ANGLE_RESERVE,
    DIAGONAL,
    OWN_CLEARANCE,
    PathLimits,
)
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.plan_check import CONSUMED, GAP_TOLERANCE, PlanCheck
from omniman_ros.planning.whole_body.platform_path import NoPathError, PlatformPath
from omniman_ros.planning.whole_body.redundancy import PATH_PARAMETER
from omniman_ros.planning.whole_body.task import BodyTask
from omniman_ros.planning.whole_body.tool_goal import DETOUR_PERIOD, RETREAT, RETREAT_STEPS

NODE = 0.1  #: Distance between the nodes of a way [m]
LEAST_NODES = 4  #: Least number of nodes of a way
CHECK_NODE = 0.05  #: Distance between the nodes of the motion by which a way is checked [m]
CHECK_PACE = 0.5  #: Fraction of the largest speed of that motion
CHECK_DURATION = 1.0  #: Duration of the parts of it that are checked together [s]
LINE_STEP = 0.02  #: Rotation between two postures of the joints' line that are looked at [rad]
SAME = 1e-3  #: Largest change of an axis that needs no motion [m, rad]
AT_GOAL = 1e-3  #: Distance from the goal at which the platform has arrived [m, rad]
SLOW = 5e-3  #: Speed of the platform at the goal at which it rests [m/s, rad/s]
LEFT = 0.1  #: Distance from its way at which the platform has left it [m, rad]


class _Order(Enum):
    """When the arm moves."""

    ON_THE_WAY, BEFORE, AFTER = range(3)


@dataclass(frozen=True)
class _Way:
    platform: PlatformPath
    joints: JointPath


class JointGoalTask(BodyTask):
    """Moves the platform to a pose and the joints to angles, both from rest to rest.

    Args:
        goal: All axes (9,) at the end [m, m, rad, and rad of each joint], the heading on any
            branch.
        back: Poses (k, 3) through which the platform leaves its start, the first; None: the route
            begins at the start.

    Raises:
        InputError: The input is invalid, or the goal is beyond a limit, occupied
            (:class:`NoPathError`), reached already, or there is no way to it.
        SolverError: casadi has no HPIPM.
    """

    leads_tool = False

    def __init__(
        self,
        setup: BodySetup,
        goal: Array,
        start: Array,
        time: float,
        around: ObstacleSnapshot,
        back: Array | None = None,
    ) -> None:
        search = _WaySearch(setup, goal, start, around, back)
        way = search.find()
        self._setup, self._goal, self._speed = setup, search.goal, search.along.speed
        self._way_check, self._tried_at = search.check(way), -math.inf
        redundancy = JointRedundancy(search.model, way.joints)
        super().__init__(search.setup, redundancy, way.platform, start, time, search.along)

    @property
    def description(self) -> str:
        """What is done, in words."""
        poses = self.way.poses
        driven = np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()
        joints = self._goal[JOINT_COLUMNS] - self.redundancy.centre
        return f"{driven:.2f} m of the platform, {np.abs(joints).max():.2f} rad of a joint"

    def is_completed(self, time: float) -> bool:
        """Return whether the joints and the platform are at rest at the goal at a time [s]."""
        z, rates = self.controller.motion.sample(time)
        off, speed = np.abs(z[:3] - self.way.poses[-1]).max(), np.abs(rates[:3]).max()
        return bool(off <= AT_GOAL and speed <= SLOW) and super().is_completed(time)

    def search(self, time: float, around: ObstacleSnapshot) -> None:
        """Find a `detour` from where the robot rests, if it needs one; see the base class.

        It does where something stands in the rest of its way, or where it has left that; every
        `DETOUR_PERIOD` at most.
        """
        z = self.controller.motion.sample(time)[0]
        place = float(z[PATH_PARAMETER])
        found = _obstruction(self._way_check, self.way, self._speed, around, place)
        off = z[:3] - self.way.at(z[3:])[0][0]
        if found is None and np.abs(off).max() <= LEFT:
            return
        refusal: InputError | None = None
        if self.rests(time) and time - self._tried_at >= DETOUR_PERIOD:
            self._tried_at = time
            start = self.redundancy.axes(z[None])[0]
            before = np.linspace(place, max(place - RETREAT, 0.0), RETREAT_STEPS)
            aside = self.way.at(before)[0] + off  # beside the way, as the robot is
            for back in (None, aside):
                try:
                    self.detour = JointGoalTask(self._setup, self._goal, start, time, around, back)
                    return
                except InputError as error:
                    refusal = error
        if found is not None:
            raise NoPathError(str(found), found)
        if refusal is not None:
            raise refusal


class _WaySearch:
    """Search for the way of one goal.

    Attributes:
        setup: The robot; :meth:`find` sets the gap that plans can keep up to the goal.
    """

    def __init__(
        self,
        setup: BodySetup,
        goal: Array,
        start: Array,
        around: ObstacleSnapshot,
        back: Array | None,
    ) -> None:
        for name, axes in (("start", start), ("goal", goal)):
            if axes.shape != (AXES,) or not np.isfinite(axes).all():
                raise InputError(f"the {name} must be {AXES} finite positions")
            plausible.demand(axes[:2], plausible.LENGTH, f"{name}: position")
            plausible.demand(axes[2:3], plausible.ANGLE, f"{name}: heading")
        self.setup, self._start = setup, start
        self._back = start[None, PLATFORM_COLUMNS] if back is None else back
        everything = np.arange(len(around.standing))
        self._around = around.selected(everything, np.zeros(0, dtype=np.intp))
        self.goal = goal.copy()
        self.goal[HEADING_COLUMN] = start[HEADING_COLUMN] + wrap(
            float(goal[HEADING_COLUMN] - start[HEADING_COLUMN])
        )
        self.model = WholeBodyModel(setup.description.mount)
        limits, o = setup.limits, setup.dodge
        speed = min(DIAGONAL * limits.velocity[0], limits.path_speeds[0])
        turn = min(limits.velocity[2], limits.path_speeds[1])
        free = (1.0 - setup.path.reserve) * o.joint_effort
        self.along = PathLimits(
            speed, DIAGONAL * limits.acceleration[0], setup.path.reserve, (0.0, 0.0)
        )
        #: Lengths (9,) in s of a unit of each axis, such that s' = `speed` keeps their limits
        self._scale = np.concatenate(
            [[1.0, 1.0, speed / turn], speed / (free * limits.velocity[JOINT_COLUMNS])]
        )
        self._gaps = BodyGaps(setup.description, setup.tool, setup.load, o.spacing)
        self._balance = BodyBalance(setup.description)

    def find(self) -> _Way:
        """Return the shortest way that passes the check of plans, or raise InputError."""
        change = np.abs(self.goal - self._start)
        if change.max() < SAME:
            raise InputError("platform and arm are already there")
        self._require_within_limits()
        self._require_own_clearance()
        dodge = replace(self.setup.dodge, clearance=self._room_at_goal())
        self.setup = replace(self.setup, dodge=dodge)
        begin, end = self._start[JOINT_COLUMNS], self.goal[JOINT_COLUMNS]
        postures = {
            _Order.ON_THE_WAY: np.stack([begin, end]),
            _Order.BEFORE: end[None],
            _Order.AFTER: begin[None],
        }
        ends = np.stack([self._back[-1], self.goal[PLATFORM_COLUMNS]])
        best: _Way | None = None
        refusal: InputError | None = None
        for order, kept in postures.items():
            try:
                way = self._timed(order, ends)  # no route is shorter
                if best is not None and best.joints.end <= way.joints.end:
                    continue
                route = self._route(ends, kept)
                if route is not None:
                    way = self._timed(order, route)
                found = _obstruction(self.check(way), way.platform, self.along.speed, self._around)
                if found is not None:
                    raise NoPathError(f"{found}, and there is no way around", found)
            except InputError as error:
                refusal = refusal or error
                continue
            if best is None or way.joints.end < best.joints.end:
                best = way
        if best is None:
            assert refusal is not None
            raise refusal
        return best

    def check(self, way: _Way) -> PlanCheck:
        """Return the check that a way must pass: where it leaves less room, plans wait."""
        kept = replace(self.setup.dodge, least_clearance=self.setup.dodge.clearance)
        redundancy = JointRedundancy(self.model, way.joints)
        return PlanCheck(redundancy, self._gaps, self._balance, None, self.setup.limits, kept)

    def _require_within_limits(self) -> None:
        limits, joints = self.setup.limits, self.goal[JOINT_COLUMNS]
        begin = self._start[JOINT_COLUMNS]  # what does not move may stay where it is
        lower = np.minimum(limits.lower[JOINT_COLUMNS] + ANGLE_RESERVE, begin)
        upper = np.maximum(limits.upper[JOINT_COLUMNS] - ANGLE_RESERVE, begin)
        for k in np.flatnonzero((joints < lower) | (joints > upper))[:1]:
            name = limits.names[JOINT_COLUMNS][k]
            raise InputError(
                f"goal: {name} = {joints[k]:.4g} rad must be from {lower[k]:.4g} to {upper[k]:.4g}"
            )

    def _require_own_clearance(self) -> None:
        """Require that the line of the joints keeps the robot's parts apart."""
        begin, end = self._start[JOINT_COLUMNS], self.goal[JOINT_COLUMNS]
        count = 2 + math.ceil(np.abs(end - begin).max() / LINE_STEP)
        placed = self._gaps.spheres.place(np.linspace(begin, end, count))
        own = self._gaps.own(placed)
        is_near = own < min(OWN_CLEARANCE, own[0] - CONSUMED)
        if is_near.any():
            k = int(is_near.argmax())
            part = k / (count - 1)
            place = part * float((self._scale[JOINT_COLUMNS] * np.abs(end - begin)).max())
            found = Obstruction(Cause.SELF, place, *self._gaps.nearest_own(placed, k))
            on_line = f"at {100.0 * part:.0f} % of the joints' line"
            where = "at the goal" if is_near[-1] else on_line
            raise NoPathError(f"{where}, {found.reason}", found)

    def _room_at_goal(self) -> float:
        """Return the gap to what stands that plans can keep up to the goal [m].

        Who is nearer to something already may stay so, down to the gap of plans that are followed.
        """
        clearance, least = self.setup.dodge.clearance, self.setup.dodge.least_clearance
        if not len(self._around.standing):
            return clearance
        axes = np.stack([self.goal, self._start])
        placed = self._gaps.spheres.place(axes[:, JOINT_COLUMNS])
        gaps, parts = self._gaps.to_obstacles(
            axes[:, PLATFORM_COLUMNS], placed.centre, self._around, np.zeros(2), math.inf
        )
        left = gaps[0] - np.clip(gaps[1], least, clearance)
        obstacle = int(left.argmin())
        if left[obstacle] < -GAP_TOLERANCE:
            name = self._gaps.part_name(int(parts[0, obstacle]))
            other = self._around.labels()[obstacle]
            found = Obstruction(Cause.STANDING, 0.0, name, other)
            raise NoPathError(f"at the goal, {found.reason}", found)
        return float(np.clip(gaps[0].min(), least, clearance))

    def _route(self, ends: Array, postures: Array) -> Array | None:
        """Return a route between two poses (2, 3) with room for postures (k, 6), if there is."""
        if np.abs(ends[1] - ends[0]).max() < SAME:
            return None
        rotation_length = float(self._scale[HEADING_COLUMN])
        standing = self._around.standing
        routes = CarriedRoutes(self.setup, postures, ends, rotation_length, standing)
        return routes.between(*ends) if routes.may_reach(ends[0], ends[1:]).all() else None

    def _timed(self, order: _Order, poses: Array) -> _Way:
        """Return a way on which the platform goes back, and then through poses (k, 3).

        Raises:
            InputError: It is longer than paths of the tool may be.
        """
        poses = np.concatenate([self._back[:-1], poses])
        begin, end = self._start[JOINT_COLUMNS], self.goal[JOINT_COLUMNS]
        scale = self._scale
        steps = np.abs(np.diff(poses, axis=0))
        steps = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), scale[2] * steps[:, 2])
        driven = np.concatenate([[0.0], np.cumsum(steps)])
        turned = float((scale[JOINT_COLUMNS] * np.abs(end - begin)).max())
        away = len(self._back) - 1  # from this pose on, the arm may move
        left, rest = float(driven[away]), float(driven[-1] - driven[away])
        if order is _Order.ON_THE_WAY:
            length = max(rest, turned)
            driven[away:] = left + (driven[away:] - left) * length / max(rest, SAME)
            moves = left, left + length
        elif order is _Order.BEFORE:
            driven[away:] += turned
            moves = left, left + turned
        else:
            moves = left + rest, left + rest + turned
        length, longest = max(float(driven[-1]), moves[1]), self.setup.path.max_length
        if length > longest:
            raise InputError(f"the way is {length:.4g} m long, at most {longest:g} m are accepted")
        at = np.linspace(0.0, length, 1 + max(LEAST_NODES, math.ceil(length / NODE)))
        nodes = np.column_stack([np.interp(at, driven, axis) for axis in poses.T])
        joints = begin + np.interp(at, moves, (0.0, 1.0))[:, None] * (end - begin)
        return _Way(
            PlatformPath(0.0, length, nodes), JointPath(joints, length, scale[JOINT_COLUMNS])
        )


def _obstruction(
    check: PlanCheck, way: PlatformPath, speed: float, around: ObstacleSnapshot, place: float = 0.0
) -> Obstruction | None:
    """Return what stands in a way from a place on [m], by the check of plans; None if nothing.

    The check looks at a motion along it, at a fraction of the speed [m/s], in short parts.
    """
    rate = CHECK_PACE * speed
    places = np.linspace(place, way.end, 2 + math.ceil((way.end - place) / CHECK_NODE))
    poses, slope = way.at(places)
    times, poses = (places - place) / rate, np.column_stack([poses, places])
    velocities = rate * np.column_stack([slope, np.ones(len(places))])
    count = math.ceil(CHECK_DURATION * rate / CHECK_NODE)
    for k in range(0, len(places) - 1, count):
        part = slice(k, k + count + 1)
        motion = HermiteTrajectory.unchecked(
            times=times[part],
            poses=poses[part],
            velocities=velocities[part],
            currents=np.zeros((len(times[part]) - 1, 0)),
        )
        index = around.standing_near(poses[k, :2], OBSTACLE_CUTOFF + check.radius)
        near = around.selected(index, np.zeros(0, dtype=np.intp))
        (verdict,) = check.judge([motion], motion.start, motion.start, near)
        if verdict.obstruction is not None:
            return verdict.obstruction
    return None
