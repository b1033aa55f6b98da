"""`omniman bench whole_body_obstacles`: the body dodges while the tool stays on its path.

The motions are executed exactly, on simulated time; the physics engine measures the distances of
the robot from what is around it. Times are CPU times of this process.
"""

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from omniman_ros.collision.parameters import ToolShape
from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.bench.dodge_scenes import KINDS, Scene, SceneMaker
from omniman_ros.lab.bench.harness import Rows, conclude, tables
from omniman_ros.lab.measurement import percentiles_ms
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.parameters import DodgeOptions
from omniman_ros.planning.whole_body.task import BodySetup, WholeBodyTask
from omniman_ros.planning.whole_body.way import NoWayError
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import load_robot
from omniman_ros.simulation.world.distances import PostureDistances

SCENES = 6  # number of scenes of each kind
SPAN = 2.5  # longest duration of a scene, relative to the path at the tool's speed
SPARE = 10.0  # what is added to it [s]
GROWTH = 0.05  # growth of the margin around a person [m/s]
TICKS = 5  # number of setpoints of a cycle, which are 10 ms apart and joined by straight lines
JUDGED = 0.05  # time between two looks at the distances [s]
LOOK_AHEAD, LOOK_STEP, LOOK_GAP = 1.0, 0.1, 0.05
"""How far the fixed posture looks ahead to wait [s], at which steps [s], and the gap below which
it waits [m]."""
COMPLETED_AIM, TIME_AIM = 0.97, 1.3
"""Aims: least share of completed scenes; largest time relative to the unhindered path."""
TOOL_AIM = 1.0, 3.0  # aims: largest root mean square and largest error of the tool [mm]
CPU_AIM = 10.0, 20.0, 50.0
"""Aims: largest median, 99th percentile and maximum of a cycle's CPU time [ms]."""
SEARCH_AIM = 1.0  # aim: largest CPU time of the search [s]
METHODS = {
    "dodging": "the body dodges",
    "fixed": "fixed posture",
    "waiting": "fixed posture that waits",
}
"""Methods that are compared, by the name in the result."""


class Bench:
    """Runs scenes."""

    def __init__(self, robot: str) -> None:
        values = load_robot(resolve_robot(robot))
        path = build(PathInterpolatorParameters, values)
        self.setup = BodySetup(
            build(DescriptionParameters, values),
            WholeBodyLimits.of_whole_body(path.core, path.arm),
            ToolShape(),
            None,
            path.tool_path,
            build(DodgeOptions, {}),
        )
        self._maker = SceneMaker(self.setup)
        self._model = WholeBodyModel(self.setup.description.mount)

    def run(self, kind: str, seed: int) -> dict[str, Any]:
        """Return the figures of a scene."""
        scene = self._maker.make(kind, seed)
        judge = PostureDistances(self.setup.description, scene.things)
        length = float(np.linalg.norm(np.diff(scene.poses[:, :3, 3], axis=0), axis=1).sum())
        limit = SPAN * length / self.setup.path.linear_velocity + SPARE
        result: dict[str, Any] = {"kind": kind, "seed": seed, "length_m": length}
        result["dodging"] = self._dodge(scene, judge, limit)
        result["fixed"] = self._fixed(scene, judge, limit, False)
        result["waiting"] = self._fixed(scene, judge, limit, True)
        return result

    def _dodge(self, scene: Scene, judge: PostureDistances, limit: float) -> dict[str, Any]:
        """Return the figures of the whole body that dodges."""
        begin = time.process_time()
        now, cycles, gaps, errors = 0.0, [], [], []
        choices: dict[str, int] = {}
        start = scene.fixed.positions[0]
        try:
            task = WholeBodyTask(self.setup, scene.poses, start, now, scene.around(now, GROWTH))
        except NoWayError as refusal:
            return {"completed": False, "refused": str(refusal), "least_gap_mm": None}
        preparation = time.process_time() - begin
        begin = time.process_time()
        task.search(now, scene.around(now, GROWTH))
        search = time.process_time() - begin
        while now < limit and not task.is_completed(now):
            around = scene.around(now, GROWTH)
            begin = time.process_time()
            outcome = task.cycle(now, around)
            cycles.append(time.process_time() - begin)
            choices[outcome.choice.value] = choices.get(outcome.choice.value, 0) + 1
            axes = task.axes(now + PERIOD * np.linspace(0.0, 1.0, 2 * TICKS + 1))
            errors.append(self._tool_errors(axes))
            gaps.append(_gap(judge, scene, axes[0], now))
            now += PERIOD
        off = 1e3 * np.concatenate(errors)
        return {
            "completed": task.is_completed(now),
            "least_gap_mm": 1e3 * min(gaps),
            "duration_s": now,
            "time_ratio": now / scene.fixed.duration,
            "tool_rms_mm": float(np.sqrt((off**2).mean())),
            "tool_max_mm": float(off.max()),
            "preparation_s": preparation,
            "search_s": search,
            "cycle_ms": percentiles_ms(cycles),
            "choices": choices,
        }

    def _tool_errors(self, axes: Array) -> Array:
        """Return the distances (n,) of the tool from its path between setpoints [m]."""
        sent = axes[::2]
        between = self._model.forward(0.5 * (sent[1:] + sent[:-1]))
        exact = self._model.forward(axes[1::2])
        result: Array = np.linalg.norm((between - exact)[:, :3, 3], axis=1)
        return result

    def _fixed(
        self, scene: Scene, judge: PostureDistances, limit: float, waits: bool
    ) -> dict[str, Any]:
        """Return the figures of today's motion; one that waits stops at once."""
        now, own, gaps, fixed = 0.0, 0.0, [], scene.fixed
        while now < limit and own < fixed.duration:
            q = fixed.sample(np.array([own]))[0][0]
            gaps.append(_gap(judge, scene, q, now))
            ahead = np.arange(LOOK_STEP, LOOK_AHEAD + 1e-9, LOOK_STEP)
            moves = fixed.sample(np.minimum(own + ahead, fixed.duration))[0]
            if not waits or all(
                _gap(judge, scene, each, now + after) > LOOK_GAP
                for each, after in zip(moves, ahead.tolist(), strict=True)
            ):
                own += JUDGED
            now += JUDGED
        return {
            "completed": own >= fixed.duration,
            "least_gap_mm": 1e3 * min(gaps),
            "duration_s": now,
            "time_ratio": now / fixed.duration,
        }


def _gap(judge: PostureDistances, scene: Scene, axes: Array, now: float) -> float:
    """Return the distance of the robot at axes (9,) from everything at a time [s], up to 1 m."""
    judge.place(axes[:3], axes[3:], scene.places_at(now))
    return float(judge.distances(1.0).min())


def summary(scenes: Sequence[dict[str, Any]], method: str) -> dict[str, Any]:
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
    driven = [row for row in rows if "cycle_ms" in row]
    if driven:
        result["tool_rms_mm"] = max(row["tool_rms_mm"] for row in driven)
        result["tool_max_mm"] = max(row["tool_max_mm"] for row in driven)
        result["search_s"] = max(row["search_s"] for row in driven)
        median, p99, worst = zip(*(row["cycle_ms"] for row in driven), strict=True)
        result["cycle_ms"] = float(np.median(median)), float(np.median(p99)), max(worst)
    return result


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body_obstacles`; return 0, the exit code of a measurement."""
    bench = Bench(args.robot)
    scenes = []
    for kind in KINDS:
        for seed in range(1 if args.quick else SCENES):
            say(f"{kind}, scene {seed} ...")
            scenes.append(bench.run(kind, seed))
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "scenes": scenes}
    result["methods"] = {method: summary(scenes, method) for method in METHODS}
    return conclude("whole_body_obstacles", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool | None]:
    """Return whether a result meets each aim; None where nothing was driven."""
    row = result["methods"]["dodging"]
    rms, largest = TOOL_AIM
    median, p99, worst = CPU_AIM
    cycle = row.get("cycle_ms")
    is_driven = cycle is not None
    return {
        "no contact": row["contacts"] == 0,
        f"{COMPLETED_AIM:.0%} completed": row["clear"] >= COMPLETED_AIM * row["scenes"],
        f"tool within {rms:g} mm RMS": row["tool_rms_mm"] <= rms if is_driven else None,
        f"tool within {largest:g} mm": row["tool_max_mm"] <= largest if is_driven else None,
        f"median time at most {TIME_AIM:g} of the unhindered": (
            row["time_ratio"] <= TIME_AIM if row["time_ratio"] is not None else None
        ),
        f"median cycle in {median:g} ms of CPU": cycle[0] <= median if cycle else None,
        f"99th percentile of a cycle in {p99:g} ms": cycle[1] <= p99 if cycle else None,
        f"every cycle in {worst:g} ms": cycle[2] <= worst if cycle else None,
        f"search in {SEARCH_AIM:g} s": row["search_s"] <= SEARCH_AIM if is_driven else None,
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [("", "completed, no contact", "contacts", "least gap", "time, median")]
    for method, text in METHODS.items():
        row = result["methods"][method]
        gap, ratio = row["least_gap_mm"], row["time_ratio"]
        rows.append(
            (
                text,
                f"{row['clear']} of {row['scenes']}",
                f"{row['contacts']}",
                "-" if gap is None else f"{gap:.0f} mm",
                "-" if ratio is None else f"{ratio:.2f}",
            )
        )
    lines = tables(rows)
    row = result["methods"]["dodging"]
    if "cycle_ms" in row:
        median, p99, worst = row["cycle_ms"]
        lines.append(
            f"tool off its path {row['tool_rms_mm']:.2f} mm RMS, {row['tool_max_mm']:.2f} mm at "
            f"most; cycle {median:.1f} ms, p99 {p99:.1f} ms, at most {worst:.1f} ms; search at "
            f"most {row['search_s']:.2f} s"
        )
    missed = [label for label, is_met in result["aims"].items() if is_met is False]
    return [*lines, f"aims missed: {', '.join(missed) if missed else 'none'}"]
