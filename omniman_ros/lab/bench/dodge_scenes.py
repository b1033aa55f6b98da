"""Scenes for the whole body: a path of the tool among posts, tables and people.

Each scene is made around a witness, a motion of the platform that can do it: what stands or
walks there keeps its distance from the witness, as the physics engine measures it, and stands or
walks in the way of a robot that keeps its posture.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.collision.solids import UprightSolids
from omniman_ros.collision.surroundings import Surroundings
from omniman_ros.console.errors import CommandError
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.planning.whole_body.surroundings import Hindrances
from omniman_ros.planning.whole_body.task import BodySetup
from omniman_ros.simulation.world.distances import PostureDistances, Prism

KINDS = ("posts", "persons", "table", "mixed")  # kinds of scenes
START: Array = np.array([0.0, 0.0, 0.0, 0.3, -1.2, 1.9, -2.2, -1.57, 0.0])
"""All axes at the start [m, rad]."""
LENGTHS = (2.0, 3.0)  # least and largest length of the tool's path [m]
WAVE = 0.2  # largest deviation of the tool's path from a straight line [m]
POSES = 40  # number of poses of the tool's path
BENDS = (0.3, 0.3, 0.6)  # largest changes of the witness's place relative to the tool [m, m, rad]
ROOM = 0.13  # least distance of what stands from the witness [m]
PASSING_ROOM = 0.2  # least distance of a person from the witness [m]
WAIT = 5.0  # time for which the witness waits for a person [s]
WALKING = (0.5, 0.9)  # least and largest speed of a person [m/s]
POST, TABLE, PERSON = (
    Prism((0.1, 0.1), 0.0, (0.0, 1.2)),
    Prism((0.3, 0.3), 0.0, (0.3, 0.34)),
    Prism((0.25, 0.25), 0.0, (0.0, 1.8)),
)
"""A post, a round table top below the tool, and a person."""
CONTENTS = {
    "posts": (POST, POST, POST),
    "persons": (PERSON, PERSON),
    "table": (TABLE,),
    "mixed": (POST, TABLE, PERSON),
}
"""What is in the scenes of each kind."""
SAMPLES = 40  # number of configurations of a motion that are looked at where something is placed
CANDIDATES = 60  # number of places that are tried at a time
TRIES = 40  # largest number of witnesses that are tried for a scene


@dataclass(frozen=True)
class Scene:
    """A path of the tool, and what is around it."""

    poses: Array  # poses (k, 4, 4) of `tool0` in odom
    fixed: TimedCurve  # motion of the robot that keeps its posture as far as it can
    things: tuple[Prism, ...]  # what is in the scene
    places: Array  # (M, 2) where it is at the start [m]
    velocities: Array  # (M, 2) velocities [m/s]

    def places_at(self, time: float) -> Array:
        """Return the places (M, 2) at a time [s]."""
        result: Array = self.places + time * self.velocities
        return result

    def around(self, time: float, growth: float) -> Hindrances:
        """Return what is around the robot at a time [s], with a growth for what moves [m/s]."""
        places = self.places_at(time)
        solids = [
            UprightSolids.cylinder(x, y, thing.semi_axes[0], thing.heights)
            for thing, (x, y) in zip(self.things, places.tolist(), strict=True)
        ]
        moves = [bool(np.any(velocity)) for velocity in self.velocities]
        walking = [each for each, moved in zip(solids, moves, strict=True) if moved]
        return Hindrances(
            time,
            UprightSolids.join([e for e, moved in zip(solids, moves, strict=True) if not moved]),
            Surroundings(UprightSolids.join(walking), self.velocities[np.array(moves)].T),
            np.full(len(walking), growth),
        )


class SceneMaker:
    """Makes scenes."""

    def __init__(self, setup: BodySetup) -> None:
        self._setup = setup
        self._model = WholeBodyModel(setup.description.mount)
        self._planner = ToolPlanner(self._model, setup.limits, setup.path)
        self._judges = {
            thing: PostureDistances(setup.description, [thing] * CANDIDATES)
            for thing in (POST, TABLE, PERSON)
        }

    def make(self, kind: str, seed: int) -> Scene:
        """Return a scene of a kind, the same for the same seed."""
        rng = np.random.default_rng([KINDS.index(kind), seed])
        for _ in range(TRIES):
            poses = self._path(rng)
            witness = self._witness(poses, rng)
            if witness is None:
                continue
            try:
                fixed = self._planner.plan(poses, START).curve
            except InputError:
                continue
            scene = self._filled(kind, poses, witness, fixed, rng)
            if scene is not None:
                return scene
        raise CommandError(f"no scene {kind} was found for seed {seed}")

    def _path(self, rng: np.random.Generator) -> Array:
        """Return poses (k, 4, 4) of the tool with its orientation at the start."""
        tool = self._model.forward(START)
        along = np.linspace(0.0, rng.uniform(*LENGTHS), POSES + 1)[1:]
        aside = WAVE * rng.uniform(-1.0, 1.0) * np.sin(math.pi * along / along[-1])
        direction = rng.uniform(-0.5, 0.5)
        c, s = math.cos(direction), math.sin(direction)
        poses = np.repeat(tool[None], POSES, axis=0)
        poses[:, 0, 3] += c * along - s * aside
        poses[:, 1, 3] += s * along + c * aside
        return poses

    def _witness(self, poses: Array, rng: np.random.Generator) -> Array | None:
        """Return all axes (k + 1, 9) of a witness at the start and at each pose, or None."""
        tool = np.concatenate([self._model.forward(START)[None], poses])
        bends = rng.uniform(-1.0, 1.0, (4, 3)) * BENDS
        bends[0] = 0.0
        share = np.linspace(0.0, 3.0, len(tool))
        smooth = share - np.sin(math.tau * share) / math.tau
        offset = np.column_stack([np.interp(smooth, range(4), bend) for bend in bends.T])
        platform = np.column_stack([tool[:, :2, 3] - tool[0, :2, 3], np.zeros(len(tool))]) + offset
        branch = self._model.arm.branch_of(START[3:])
        arm = self._model.arm_angles(platform, tool, branch, START[3:])
        jumps = np.abs(np.diff(arm, axis=0)).max()
        away = np.abs(arm - START[3:]).max()
        margin = np.minimum(np.sin(arm[:, 2]), -np.sin(arm[:, 4])).min()
        is_possible = jumps < 0.3 and away < 2.0 and margin > 0.25
        return np.hstack([platform, arm]) if is_possible else None

    def _filled(
        self,
        kind: str,
        poses: Array,
        witness: Array,
        fixed: TimedCurve,
        rng: np.random.Generator,
    ) -> Scene | None:
        """Return a scene with everything placed, or None if there is no place for it."""
        places, velocities = [], []
        for thing in CONTENTS[kind]:
            found = (
                self._walk(poses, witness, fixed, rng)
                if thing is PERSON
                else self._stand(thing, poses, witness, fixed, rng)
            )
            if found is None:
                return None
            places.append(found[0])
            velocities.append(found[1])
        return Scene(poses, fixed, CONTENTS[kind], np.array(places), np.array(velocities))

    def _stand(
        self,
        thing: Prism,
        poses: Array,
        witness: Array,
        fixed: TimedCurve,
        rng: np.random.Generator,
    ) -> tuple[Array, Array] | None:
        """Return a place in the way of the fixed posture and beside the witness, and zeros."""
        way = fixed.sample(np.linspace(0.0, fixed.duration, SAMPLES))[0]
        anchor = way[rng.integers(SAMPLES // 5, SAMPLES, CANDIDATES), :2]
        places = anchor + rng.uniform(-0.9, 0.9, (CANDIDATES, 2))
        judge = self._judges[thing]
        clear, hit = np.full(CANDIDATES, np.inf), np.full(CANDIDATES, np.inf)
        for q in witness:
            judge.place(q[:3], q[3:], places)
            clear = np.minimum(clear, judge.distances(1.0))
        for q in way:
            judge.place(q[:3], q[3:], places)
            hit = np.minimum(hit, judge.distances(1.0))
        chosen = np.flatnonzero((clear >= ROOM) & (hit <= 0.0))
        return (places[chosen[0]], np.zeros(2)) if len(chosen) else None

    def _walk(
        self, poses: Array, witness: Array, fixed: TimedCurve, rng: np.random.Generator
    ) -> tuple[Array, Array] | None:
        """Return place and velocity of a person who meets the fixed posture, not the witness.

        The witness waits for the person, at a place on the way.
        """
        judge, speed = self._judges[PERSON], self._setup.path.linear_velocity
        spacing = float(np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3]))
        arrival = spacing * np.arange(len(witness)) / speed
        count = CANDIDATES
        met = rng.integers(len(poses) // 3, len(poses), count)
        meeting = arrival[met]
        stop = np.maximum(meeting - rng.uniform(2.5, 4.0, count), 0.0)
        angle = rng.choice([-1.0, 1.0], count) * rng.uniform(1.0, 2.1, count)
        walking = rng.uniform(*WALKING, count)
        velocities = walking[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        spot = 0.5 * (poses[met - 1, :2, 3] + witness[met, :2])
        starts = spot - meeting[:, None] * velocities
        clear, hit = np.full(count, np.inf), np.full(count, np.inf)
        for time in np.linspace(0.0, float(arrival[-1]) + WAIT, SAMPLES):
            now = starts + time * velocities
            q = fixed.sample(np.array([min(time, fixed.duration)]))[0][0]
            judge.place(q[:3], q[3:], now)
            hit = np.minimum(hit, judge.distances(1.0))
            # The witness's own time stands still while it waits: it differs for each candidate.
            own = np.where(time < stop, time, np.maximum(stop, time - WAIT))
            for k in np.unique(np.round(own / arrival[1]).astype(int)):
                index = min(int(k), len(witness) - 1)
                same = np.round(own / arrival[1]).astype(int) == k
                judge.place(witness[index, :3], witness[index, 3:], now)
                clear[same] = np.minimum(clear[same], judge.distances(1.0)[same])
        chosen = np.flatnonzero((clear >= PASSING_ROOM) & (hit <= 0.0))
        return (starts[chosen[0]], velocities[chosen[0]]) if len(chosen) else None
