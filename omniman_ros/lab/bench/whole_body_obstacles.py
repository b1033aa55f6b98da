"""`omniman bench whole_body_obstacles`: the body dodges while the tool stays on its path.

The motions are executed exactly, on simulated time; the physics engine measures the distances of
the robot from what is around it. Times are CPU times of this process.
"""

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from omniman_ros.console.terminal import say
from omniman_ros.lab.bench.harness import BenchmarkTable, Figure, at_least, at_most, conclude
from omniman_ros.lab.measurement import spread_ms
from omniman_ros.lab.studies.avoidance_scenes import KINDS, AvoidanceScene, SceneGenerator
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.task import WholeBodyTask
from omniman_ros.simulation.world.distances import ConfigurationDistances

COMPLETED_AIM = 0.97  #: aim: least fraction of completed scenes
TIME_AIM = 1.3  #: aim: largest time relative to the unhindered path
RMS_AIM, OFF_AIM = 1.0, 3.0  #: aims: largest root mean square and largest error of the tool [mm]
CPU_AIM = {"median": 10.0, "p99": 20.0, "max": 50.0}  #: aims: largest CPU times of a cycle [ms]
SEARCH_AIM = 1.0  #: aim: largest CPU time of the search [s]
SCENES = 6  #: number of scenes of each kind
SPAN, SPARE = 2.5, 10.0  #: longest duration: times that at the tool's speed, and added to it [s]
TICKS = 5  #: number of setpoints of a cycle, which are 10 ms apart and joined by straight lines
JUDGED = 0.05  #: time between two looks at the distances [s]
AHEAD = np.arange(0.1, 1.0 + 1e-9, 0.1)  #: times at which the fixed posture looks ahead [s]
AHEAD_GAP = 0.05  #: gap below which it waits [m]
METHODS = {"dodging": "the body avoids", "waiting": "fixed posture that waits"}


class ExactBench:
    """Runs scenes.

    Args:
        setup: What a task needs to know of the robot.
    """

    def __init__(self, setup: BodySetup) -> None:
        self.setup = setup
        self._model = WholeBodyModel(setup.description.mount)

    def run(self, kind: str, seed: int, scene: AvoidanceScene) -> dict[str, Any]:
        """Return the figures of a scene."""
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
    generator, scenes = SceneGenerator(args.robot), []
    bench = ExactBench(generator.setup)
    for kind in KINDS:
        for seed, scene in generator.scenes(kind, 1 if args.quick else SCENES):
            say(f"{kind}, scene {seed} ...")
            scenes.append(bench.run(kind, seed, scene))
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
