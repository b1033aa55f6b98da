"""Scenes for the whole body: a path of the tool, and what stands or walks in the way.

Each scene is made around a witness, a motion of the platform that can do it: what stands or walks
there keeps its distance from the witness, and stands or walks in the way of a robot that keeps its
posture. A crowd has no witness. The physics engine measures the distances of the robot from what
is around it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.parameters import ToolShape
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions, BodySetup
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism

#: All axes at the start [m, rad]
START: Array = np.array([0.0, 0.0, 0.0, 0.3, -1.2, 1.9, -2.2, -1.57, 0.0])
LENGTHS, WAVE = (2.0, 3.0), 0.2  #: of the tool's path, and deviation from a straight line [m]
POSES = 40  #: number of poses of the tool's path
BENDS = (0.3, 0.3, 0.6)  #: largest changes of the witness's place relative to the tool [m, m, rad]
ROOM, PASSING_ROOM = (
    0.13,
    0.2,
)  #: least distances of what stands and who walks from the witness [m]
WAIT = 5.0  #: time for which the witness waits for a person [s]
WALKING = (0.5, 0.9)  #: least and largest speed of a person [m/s]
POST = Prism((0.1, 0.1), 0.0, (0.0, 1.2))
TABLE = Prism((0.3, 0.3), 0.0, (0.3, 0.34))  #: a round table top below the tool
PERSON = Prism((0.25, 0.25), 0.0, (0.0, 1.8))
KINDS = {
    "posts": (POST, POST, POST),
    "persons": (PERSON, PERSON),
    "table": (TABLE,),
    "mixed": (POST, TABLE, PERSON),
}
CROWD, LATE = "crowd", "late"  #: Kinds of scenes without a promise that they can be done
WALKERS = (4, 6)  #: least and largest number of persons in a crowd
#: Distance of a walker's line from the tool's path [m], and from the robot before it begins [m]
PASSING, BEFORE = 1.0, 1.5
SIGHT = 2.0  #: distance from which on posts are seen that are seen late [m]
PLACE_STEP = 0.005  #: distance between two places on the path of which a bound of time is made [m]
SAMPLES = 40  #: number of configurations of a motion that are looked at where something is placed
TRIED, TRIES = 60, 40  #: number of places that are tried at a time, and of witnesses for a scene


@dataclass(frozen=True)
class AvoidanceScene:
    """A path of the tool, and what is around it."""

    poses: Array  #: poses (k, 4, 4) of `tool0` in odom
    fixed: TimedCurve  #: motion of the robot that keeps its posture as far as it can
    things: tuple[Prism, ...]  #: what is in the scene
    places: Array  #: (M, 2) where it is at the start [m]
    velocities: Array  #: (M, 2) velocities [m/s]
    sight: float = math.inf  #: distance from which on what stands is seen [m]

    def in_sight(self, robot: Array, places: Array) -> Indices:
        """Return the numbers of what is seen from a position (2,), at places (M, 2) [m]."""
        offset = places - robot
        is_near = np.hypot(offset[:, 0], offset[:, 1]) <= self.sight
        return np.flatnonzero(is_near | np.any(self.velocities, axis=1))

    def places_at(self, time: float) -> Array:
        """Return where everything is (M, 2) at a time [m]."""
        places: Array = self.places + time * self.velocities
        return places

    def least_time(self, speed: float, clearance: float, time_gap: float) -> float:
        """Return a lower bound of the time of each motion with the tool on its path [s].

        Such a motion has at most a speed [m/s] along the path. The origin of `tool0` keeps from
        who walks by a clearance [m] and what they walk in a time gap [s]. Platform, arm, what
        stands and accelerations are left out. The bound is infinite where there is none within
        twice the unhindered time and `WAIT`.
        """
        spots = self.poses[:, :2, 3]
        lengths = np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1)
        # The path's first pose is one step from where the tool is at first.
        places = np.concatenate([[0.0], lengths[:1], lengths]).cumsum()
        spots = np.concatenate([2.0 * spots[:1] - spots[1:2], spots])
        grid = np.linspace(0.0, places[-1], math.ceil(places[-1] / PLACE_STEP) + 1)
        spots = np.column_stack([np.interp(grid, places, each) for each in spots.T])
        walks = np.flatnonzero(np.any(self.velocities, axis=1))
        room = clearance + time_gap * np.hypot(*self.velocities[walks].T)
        room += [max(self.things[k].semi_axes) for k in walks]
        is_reached, now = np.arange(len(grid)) == 0, 0.0
        while not is_reached[-1]:
            now += grid[1] / speed
            is_reached[1:] |= is_reached[:-1]
            apart = spots[:, None] - self.places_at(now)[walks]
            is_reached &= (np.hypot(apart[..., 0], apart[..., 1]) >= room).all(axis=1)
            if not is_reached.any() or now > 2.0 * self.fixed.duration + WAIT:
                return math.inf
        return now


class SceneGenerator:
    """Makes the scenes of a robot."""

    def __init__(self, robot: str) -> None:
        values = robot_parameters(resolve_robot(robot))
        path = build(PathInterpolatorParameters, values)
        description = build(DescriptionParameters, values)
        limits = WholeBodyLimits.of_whole_body(path.core, path.arm)
        options = build(AvoidanceOptions, {})
        self.setup = BodySetup(description, limits, ToolShape(), None, path.tool_path, options)
        self.model = WholeBodyModel(description.mount)
        self.planner = ToolPlanner(self.model, limits, path.tool_path)
        self._judges = {
            thing: ConfigurationDistances(description, [thing] * TRIED)
            for thing in (POST, TABLE, PERSON)
        }

    def scenes(self, kind: str, count: int) -> Iterator[tuple[int, AvoidanceScene]]:
        """Yield the first scenes of a kind, with their seeds; a few seeds have none."""
        seed = 0
        while count > 0:
            scene = self.scene(kind, seed)
            if scene is not None:
                yield seed, scene
                count -= 1
            seed += 1

    def scene(self, kind: str, seed: int) -> AvoidanceScene | None:
        """Return the scene of a kind for a seed, or None if none was found."""
        rng = np.random.default_rng([[*KINDS, CROWD, LATE].index(kind), seed])
        if kind == CROWD:
            return self._crowd(rng)
        if kind == LATE:
            found = self._with_witness("posts", rng)
            return None if found is None else replace(found, sight=SIGHT)
        return self._with_witness(kind, rng)

    def _crowd(self, rng: np.random.Generator) -> AvoidanceScene | None:
        """Return a path across which people walk straight on, each at a speed of its own."""
        poses = self._path(rng)
        try:
            fixed = self.planner.plan(poses, START).curve
        except InputError:
            return None
        count = int(rng.integers(WALKERS[0], WALKERS[1] + 1))
        starts, velocities = list[Array](), list[Array]()
        while len(starts) < count:
            way = fixed.sample(np.array([fixed.duration * rng.uniform()]))[0][0, :2]
            spot = way + rng.uniform(-PASSING, PASSING, 2)
            angle, speed = rng.uniform(-math.pi, math.pi), rng.uniform(*WALKING)
            velocity = speed * np.array([math.cos(angle), math.sin(angle)])
            start = spot - rng.uniform(0.2, 1.0) * fixed.duration * velocity
            if np.hypot(*(start - START[:2])) > BEFORE:
                starts.append(start)
                velocities.append(velocity)
        people = (PERSON,) * count
        return AvoidanceScene(poses, fixed, people, np.array(starts), np.array(velocities))

    def _with_witness(self, kind: str, rng: np.random.Generator) -> AvoidanceScene | None:
        for _ in range(TRIES):
            poses = self._path(rng)
            witness = self._witness(poses, rng)
            if witness is None:
                continue
            try:
                fixed = self.planner.plan(poses, START).curve
            except InputError:
                continue
            placed = [self._placed(thing, poses, witness, fixed, rng) for thing in KINDS[kind]]
            if None not in placed:
                places, velocities = map(np.array, zip(*filter(None, placed), strict=True))
                return AvoidanceScene(poses, fixed, KINDS[kind], places, velocities)
        return None

    def _path(self, rng: np.random.Generator) -> Array:
        """Return poses (k, 4, 4) of the tool with its orientation at the start."""
        along = np.linspace(0.0, rng.uniform(*LENGTHS), POSES + 1)[1:]
        aside = WAVE * rng.uniform(-1.0, 1.0) * np.sin(math.pi * along / along[-1])
        direction = rng.uniform(-0.5, 0.5)
        c, s = math.cos(direction), math.sin(direction)
        poses = np.repeat(self.model.forward(START)[None], POSES, axis=0)
        poses[:, 0, 3] += c * along - s * aside
        poses[:, 1, 3] += s * along + c * aside
        return poses

    def _witness(self, poses: Array, rng: np.random.Generator) -> Array | None:
        """Return all axes (k + 1, 9) of a witness at the start and at each pose, or None."""
        tool = np.concatenate([self.model.forward(START)[None], poses])
        bends = rng.uniform(-1.0, 1.0, (4, 3)) * BENDS
        bends[0] = 0.0
        fraction = np.linspace(0.0, 3.0, len(tool))
        smooth = fraction - np.sin(math.tau * fraction) / math.tau
        platform = np.column_stack([np.interp(smooth, range(4), bend) for bend in bends.T])
        platform[:, :2] += tool[:, :2, 3] - tool[0, :2, 3]
        branch = self.model.arm.branch_of(START[3:])
        arm = self.model.arm_angles(platform, tool, branch, START[3:])
        jumps = np.abs(np.diff(arm, axis=0)).max()
        margin = np.minimum(np.sin(arm[:, 2]), -np.sin(arm[:, 4])).min()
        possible = jumps < 0.3 and np.abs(arm - START[3:]).max() < 2.0 and margin > 0.25
        return np.hstack([platform, arm]) if possible else None

    def _gaps(self, thing: Prism, axes: Array, places: Array) -> Array:
        """Return the gaps between the robot and a thing at each of the places, up to 1 m."""
        judge = self._judges[thing]
        judge.place(axes[:3], axes[3:], places)
        return judge.distances(1.0)

    def _placed(
        self, thing: Prism, poses: Array, witness: Array, fixed: TimedCurve, rng: Any
    ) -> tuple[Array, Array] | None:
        """Return place (2,) and velocity (2,) of what meets the fixed posture, not the witness.

        A person walks, and the witness waits for it on its way, at a time of its own.
        """
        spacing = float(np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3]))
        arrival = spacing * np.arange(len(witness)) / self.setup.path.linear_velocity
        stop, room = np.full(TRIED, np.inf), ROOM
        if thing is PERSON:
            met, room = rng.integers(len(poses) // 3, len(poses), TRIED), PASSING_ROOM
            stop = np.maximum(arrival[met] - rng.uniform(2.5, 4.0, TRIED), 0.0)
            angle = rng.choice([-1.0, 1.0], TRIED) * rng.uniform(1.0, 2.1, TRIED)
            speed = rng.uniform(*WALKING, TRIED)[:, None]
            velocities = speed * np.column_stack([np.cos(angle), np.sin(angle)])
            spot = 0.5 * (poses[met - 1, :2, 3] + witness[met, :2])
            starts = spot - arrival[met][:, None] * velocities
        else:
            way = fixed.sample(np.linspace(0.0, fixed.duration, SAMPLES))[0]
            anchor = way[rng.integers(SAMPLES // 5, SAMPLES, TRIED), :2]
            starts, velocities = anchor + rng.uniform(-0.9, 0.9, (TRIED, 2)), np.zeros((TRIED, 2))
        clear, hit = np.full(TRIED, np.inf), np.full(TRIED, np.inf)
        for now in np.linspace(0.0, float(arrival[-1]) + WAIT, 2 * SAMPLES):
            places = starts + now * velocities
            q = fixed.sample(np.array([min(now, fixed.duration)]))[0][0]
            hit = np.minimum(hit, self._gaps(thing, q, places))
            own = np.where(now < stop, now, np.maximum(stop, now - WAIT))
            steps = np.minimum(np.round(own / arrival[1]).astype(int), len(witness) - 1)
            for k in np.unique(steps):
                gaps = self._gaps(thing, witness[k], places)
                clear = np.where(steps == k, np.minimum(clear, gaps), clear)
        found = np.flatnonzero((clear >= room) & (hit <= 0.0))
        return (starts[found[0]], velocities[found[0]]) if len(found) else None
