"""`omniman bench whole_body_obstacles`: the body dodges while the tool stays on its path.

Each scene is made around a witness, a motion of the platform that can do it: what stands or walks
there keeps its distance from the witness, and stands or walks in the way of a robot that keeps its
posture. The motions are executed exactly, on simulated time; the physics engine measures the
distances of the robot from what is around it. Times are CPU times of this process.
"""

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.parameters import ToolShape
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.bench.harness import BenchmarkTable, Figure, at_least, at_most, conclude
from omniman_ros.lab.measurement import spread_ms
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions, BodySetup
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.task import WholeBodyTask
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism

COMPLETED_AIM = 0.97  #: aim: least fraction of completed scenes
TIME_AIM = 1.3  #: aim: largest time relative to the unhindered path
RMS_AIM, OFF_AIM = 1.0, 3.0  #: aims: largest root mean square and largest error of the tool [mm]
CPU_AIM = {"median": 10.0, "p99": 20.0, "max": 50.0}  #: aims: largest CPU times of a cycle [ms]
SEARCH_AIM = 1.0  #: aim: largest CPU time of the search [s]
SCENES = 6  #: number of scenes of each kind
SPAN, SPARE = 2.5, 10.0  #: longest duration: times that at the tool's speed, and added to it [s]
GROWTH = 0.05  #: growth of the margin around a person [m/s]
TICKS = 5  #: number of setpoints of a cycle, which are 10 ms apart and joined by straight lines
JUDGED = 0.05  #: time between two looks at the distances [s]
AHEAD = np.arange(0.1, 1.0 + 1e-9, 0.1)  #: times at which the fixed posture looks ahead [s]
AHEAD_GAP = 0.05  #: gap below which it waits [m]
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
SAMPLES = 40  #: number of configurations of a motion that are looked at where something is placed
TRIED, TRIES = 60, 40  #: number of places that are tried at a time, and of witnesses for a scene
METHODS = {"dodging": "the body avoids", "waiting": "fixed posture that waits"}


@dataclass(frozen=True)
class AvoidanceScene:
    """A path of the tool, and what is around it."""

    poses: Array  #: poses (k, 4, 4) of `tool0` in odom
    fixed: TimedCurve  #: motion of the robot that keeps its posture as far as it can
    things: tuple[Prism, ...]  #: what is in the scene
    places: Array  #: (M, 2) where it is at the start [m]
    velocities: Array  #: (M, 2) velocities [m/s]

    def around(self, time: float) -> ObstacleSnapshot:
        """Return what is around the robot at a time [s]."""
        places, moves = self.places + time * self.velocities, np.any(self.velocities, axis=1)
        obstacles = [
            UprightObstacles.cylinder(x, y, thing.semi_axes[0], thing.heights)
            for thing, (x, y) in zip(self.things, places.tolist(), strict=True)
        ]
        standing, walking = (
            UprightObstacles.join([obstacles[k] for k in np.flatnonzero(chosen)])
            for chosen in (~moves, moves)
        )
        surroundings = MovingObstacles(walking, self.velocities[moves].T)
        return ObstacleSnapshot(time, standing, surroundings, np.full(int(moves.sum()), GROWTH))

    def gap(self, judge: ConfigurationDistances, axes: Array, time: float) -> float:
        """Return the distance of the robot at axes (9,) from everything at a time, up to 1 m."""
        judge.place(axes[:3], axes[3:], self.places + time * self.velocities)
        return float(judge.distances(1.0).min())


class Bench:
    """Makes scenes, and runs them."""

    def __init__(self, robot: str) -> None:
        values = robot_parameters(resolve_robot(robot))
        path = build(PathInterpolatorParameters, values)
        description = build(DescriptionParameters, values)
        limits = WholeBodyLimits.of_whole_body(path.core, path.arm)
        options = build(AvoidanceOptions, {})
        self.setup = BodySetup(description, limits, ToolShape(), None, path.tool_path, options)
        self._model = WholeBodyModel(description.mount)
        self._planner = ToolPlanner(self._model, limits, path.tool_path)
        self._judges = {
            thing: ConfigurationDistances(description, [thing] * TRIED)
            for thing in (POST, TABLE, PERSON)
        }

    def scene(self, kind: str, seed: int) -> AvoidanceScene:
        """Return a scene of a kind, the same for the same seed."""
        rng = np.random.default_rng([list(KINDS).index(kind), seed])
        for _ in range(TRIES):
            poses = self._path(rng)
            witness = self._witness(poses, rng)
            if witness is None:
                continue
            try:
                fixed = self._planner.plan(poses, START).curve
            except InputError:
                continue
            placed = [self._placed(thing, poses, witness, fixed, rng) for thing in KINDS[kind]]
            if None not in placed:
                places, velocities = map(np.array, zip(*filter(None, placed), strict=True))
                return AvoidanceScene(poses, fixed, KINDS[kind], places, velocities)
        raise CommandError(f"no scene {kind} was found for seed {seed}")

    def _path(self, rng: np.random.Generator) -> Array:
        """Return poses (k, 4, 4) of the tool with its orientation at the start."""
        along = np.linspace(0.0, rng.uniform(*LENGTHS), POSES + 1)[1:]
        aside = WAVE * rng.uniform(-1.0, 1.0) * np.sin(math.pi * along / along[-1])
        direction = rng.uniform(-0.5, 0.5)
        c, s = math.cos(direction), math.sin(direction)
        poses = np.repeat(self._model.forward(START)[None], POSES, axis=0)
        poses[:, 0, 3] += c * along - s * aside
        poses[:, 1, 3] += s * along + c * aside
        return poses

    def _witness(self, poses: Array, rng: np.random.Generator) -> Array | None:
        """Return all axes (k + 1, 9) of a witness at the start and at each pose, or None."""
        tool = np.concatenate([self._model.forward(START)[None], poses])
        bends = rng.uniform(-1.0, 1.0, (4, 3)) * BENDS
        bends[0] = 0.0
        fraction = np.linspace(0.0, 3.0, len(tool))
        smooth = fraction - np.sin(math.tau * fraction) / math.tau
        platform = np.column_stack([np.interp(smooth, range(4), bend) for bend in bends.T])
        platform[:, :2] += tool[:, :2, 3] - tool[0, :2, 3]
        branch = self._model.arm.branch_of(START[3:])
        arm = self._model.arm_angles(platform, tool, branch, START[3:])
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

    def run(self, kind: str, seed: int) -> dict[str, Any]:
        """Return the figures of a scene."""
        scene = self.scene(kind, seed)
        judge = ConfigurationDistances(self.setup.description, scene.things)
        length = float(np.linalg.norm(np.diff(scene.poses[:, :3, 3], axis=0), axis=1).sum())
        limit = SPAN * length / self.setup.path.linear_velocity + SPARE
        figures: dict[str, Any] = {"kind": kind, "seed": seed}
        for method, drive in (("dodging", self._avoid), ("waiting", self._wait)):
            figures[method] = drive(scene, judge, limit)
        return figures

    def _avoid(
        self, scene: AvoidanceScene, judge: ConfigurationDistances, limit: float
    ) -> dict[str, Any]:
        """Return the figures of the whole body that dodges."""
        now, cycles, gaps, errors = 0.0, [], [], []
        start = scene.fixed.positions[0]
        try:
            task = WholeBodyTask(self.setup, scene.poses, start, now, scene.around(now))
        except NoPathError as refusal:
            return {"completed": False, "refused": str(refusal), "least_gap_mm": None}
        begin = time.process_time()
        task.search(now, scene.around(now))
        search = time.process_time() - begin
        while now < limit and not task.is_completed(now):
            around = scene.around(now)
            begin = time.process_time()
            task.cycle(now, around)
            cycles.append(time.process_time() - begin)
            # The tool is off its path between setpoints, which are joined by straight lines.
            axes = task.axes(now + PERIOD * np.linspace(0.0, 1.0, 2 * TICKS + 1))
            between = self._model.forward(0.5 * (axes[2::2] + axes[:-2:2]))
            off = (between - self._model.forward(axes[1::2]))[:, :3, 3]
            errors.append(np.linalg.norm(off, axis=1))
            gaps.append(scene.gap(judge, axes[0], now))
            now += PERIOD
        all_errors = 1e3 * np.concatenate(errors)
        return {
            "completed": task.is_completed(now),
            "least_gap_mm": 1e3 * min(gaps),
            "time_ratio": now / scene.fixed.duration,
            "tool_rms_mm": float(np.sqrt((all_errors**2).mean())),
            "tool_max_mm": float(all_errors.max()),
            "search_s": search,
            "cycle": spread_ms(cycles),
        }

    def _wait(
        self, scene: AvoidanceScene, judge: ConfigurationDistances, limit: float
    ) -> dict[str, Any]:
        """Return the figures of a robot that keeps its posture, and stops at once to wait."""
        now, own, gaps, fixed = 0.0, 0.0, [], scene.fixed
        while now < limit and own < fixed.duration:
            gaps.append(scene.gap(judge, fixed.sample(np.array([own]))[0][0], now))
            moves = fixed.sample(np.minimum(own + AHEAD, fixed.duration))[0]
            pairs = zip(moves, AHEAD.tolist(), strict=True)
            if all(scene.gap(judge, each, now + after) > AHEAD_GAP for each, after in pairs):
                own += JUDGED
            now += JUDGED
        completed = own >= fixed.duration
        ratio = now / fixed.duration
        return {"completed": completed, "least_gap_mm": 1e3 * min(gaps), "time_ratio": ratio}


def summary(scenes: Sequence[Mapping[str, Any]], method: str) -> dict[str, Any]:
    """Return the figures of a method in all scenes."""
    rows = [scene[method] for scene in scenes]
    gaps = [row["least_gap_mm"] for row in rows if row["least_gap_mm"] is not None]
    clear = [row for row in rows if row["completed"] and row["least_gap_mm"] > 0.0]
    result: dict[str, Any] = {
        "scenes": len(rows),
        "clear": len(clear),
        "contacts": sum(gap <= 0.0 for gap in gaps),
        "least_gap_mm": min(gaps) if gaps else None,
        "time_ratio": float(np.median([row["time_ratio"] for row in clear])) if clear else None,
    }
    driven = [row for row in rows if "cycle" in row]
    for key in ("tool_rms_mm", "tool_max_mm", "search_s"):
        result[key] = max((row[key] for row in driven), default=None)
    for key, reduced in (("median", np.median), ("p99", np.median), ("max", np.max)):
        each = [row["cycle"][f"{key}_ms"] for row in driven]
        result[f"cycle_{key}_ms"] = float(reduced(each)) if driven else None
    return result


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body_obstacles`; return 0, the exit code of a measurement."""
    bench, scenes = Bench(args.robot), []
    for kind in KINDS:
        for seed in range(1 if args.quick else SCENES):
            say(f"{kind}, scene {seed} ...")
            scenes.append(bench.run(kind, seed))
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "scenes": scenes}
    result["methods"] = {method: summary(scenes, method) for method in METHODS}
    return conclude("whole_body_obstacles", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    rows = []
    for method, text in METHODS.items():
        each = result["methods"][method]
        gap, ratio = each["least_gap_mm"], each["time_ratio"]
        counts = f"{each['clear']} of {each['scenes']}", f"{each['contacts']}"
        shown = "-" if gap is None else f"{gap:.0f} mm", "-" if ratio is None else f"{ratio:.2f}"
        rows.append(Figure(text, (*counts, *shown)))
    row = result["methods"]["dodging"]
    least = math.ceil(COMPLETED_AIM * row["scenes"])
    aimed = [
        at_most("contacts", row["contacts"], 0),
        at_least("completed without contact", row["clear"], least),
        at_most("tool off its path, RMS", row["tool_rms_mm"], RMS_AIM, "{:.2g} mm"),
        at_most("tool off its path", row["tool_max_mm"], OFF_AIM, "{:.2g} mm"),
        at_most("time over the unhindered one, median", row["time_ratio"], TIME_AIM),
        *(
            at_most(f"CPU of a cycle, {key}", row[f"cycle_{key}_ms"], aim, "{:.1f} ms")
            for key, aim in CPU_AIM.items()
        ),
        at_most("CPU of the search", row["search_s"], SEARCH_AIM, "{:.2f} s"),
    ]
    titles = ("completed, no contact", "contacts", "least gap", "time, median")
    return [BenchmarkTable(titles, rows), BenchmarkTable(("the body avoids",), aimed)]
