"""`omniman bench whole_body`: planning of tool paths, CPU of their stream, inverse kinematics.

CPU time of this process, and of the running nodes; the machine may do other things meanwhile.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.cli import bench_whole_body_inverse as inverse
from omniman_ros.cli import bench_whole_body_stream as stream
from omniman_ros.cli import results
from omniman_ros.cli.fleet import resolved
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.terminal import say, table
from omniman_ros.core.body.body_way import BodyWay
from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import PLATFORM_AXES, BodyModel, planar
from omniman_ros.core.body.posture import PostureResolver
from omniman_ros.core.body.tool_curve import ToolCurve
from omniman_ros.core.body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.core.body.tool_timing import ToolTimer
from omniman_ros.core.parameters import build
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.motions.parameters import PathInterpolatorParameters
from omniman_ros.robots import load_robot
from omniman_ros.studies.tool_courses import COURSES, POSTURE, start

Array = NDArray[np.float64]

SIZES = {100: 4.0, 10_000: 12.0}
"""Poses of a path: its length [m]."""
STREAMED = ("circle", 10_000)
"""The plan whose previews are measured."""


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        courses: Of the paths.
        plans: Of each path.
        blocks: Of previews.
        tries: Poses for each iteration.
        least: CPU time of a measurement of the closed form [s].
        seconds: Nodes at rest, nodes at work [s].
    """

    courses: tuple[str, ...]
    plans: int
    blocks: int
    tries: int
    least: float
    seconds: float


FULL = Effort(tuple(COURSES), plans=7, blocks=9, tries=300, least=0.3, seconds=12.0)
QUICK = Effort(("circle",), plans=1, blocks=2, tries=10, least=0.01, seconds=2.0)


class Bench:
    """Plans of a robot, and what they are like.

    Args:
        parameters: Of the node `path_interpolator`.
    """

    def __init__(self, parameters: PathInterpolatorParameters) -> None:
        p = parameters
        self._options = p.tool_path
        self.model = BodyModel(p.mount)
        self.limits = BodyLimits.of_body(p.core, p.arm)
        self._planner = ToolPlanner(self.model, self.limits, p.tool_path)
        self._resolver = PostureResolver(self.model, self.limits, p.tool_path)
        self._timer = ToolTimer(self.limits, p.tool_path)

    def plan(self, poses: Array) -> ToolPlan:
        """The plan of a path (k, 4, 4) from the study's start on."""
        return self._planner.plan(poses, start())

    def figures(self, poses: Array, repeats: int) -> dict[str, Any]:
        """Times of planning a path (k, 4, 4), by parts, and what the plan is like."""
        plan = self.plan(poses)
        taken = median_cpu(lambda: self.plan(poses), repeats)
        speed = self._options.linear_velocity
        parts = self._parts(poses, repeats)
        parts["checks"] = max(1e3 * taken - sum(parts.values()), 0.0)
        plain = median_cpu(lambda: carried(self.model, poses, speed), repeats)
        alone = plan.length / speed
        return {
            "planning_ms": 1e3 * taken,
            "parts_ms": parts,
            "plain_resampling_ms": 1e3 * plain,
            "ratio": taken / plain,
            "length_m": plan.length,
            "duration_s": plan.curve.duration,
            "duration_ratio": plan.curve.duration / alone,
            "limits_used": used(plan, self.limits),
            **quality(plan, self.model),
        }

    def _parts(self, poses: Array, repeats: int) -> dict[str, float]:
        """Median CPU time of each part of planning [ms], but for what checks input and result."""
        times: dict[str, list[float]] = {"curve": [], "postures": [], "timing": []}
        here = start()
        frame = planar(here[:3])
        all_poses = np.linalg.inv(frame) @ np.concatenate([self.model.forward(here)[None], poses])
        branch = self.model.arm.branch_of(here[3:])
        for _ in range(repeats):
            marks = [time.process_time()]
            path = ToolCurve(all_poses, self._options, frame)
            marks.append(time.process_time())
            local = np.concatenate([np.zeros(len(PLATFORM_AXES)), here[3:]])
            postures = self._resolver.resolve(path, local)
            marks.append(time.process_time())
            self._timer.timed(BodyWay(self.model, path, postures, branch))
            marks.append(time.process_time())
            for name, taken in zip(times, np.diff(marks).tolist(), strict=True):
                times[name].append(1e3 * taken)
        return {name: statistics.median(values) for name, values in times.items()}


def course_poses(model: BodyModel, name: str, length: float, count: int) -> Array:
    """Poses (count, 4, 4) of a course of the study of tool paths, equally far apart.

    Args:
        model: Of the robot.
        name: One of COURSES.
        length: Of the way in the plane [m].
        count: Of the poses.
    """
    course = COURSES[name](np.linspace(0.0, length, count), length)
    poses = np.tile(model.forward(start()), (count, 1, 1))
    poses[:, :3, 3] += course[:, :3]
    turn = planar(np.column_stack([np.zeros((count, 2)), course[:, 3]]))[:, :3, :3]
    poses[:, :3, :3] = turn @ poses[:, :3, :3]
    return poses


def carried(model: BodyModel, poses: Array, speed: float) -> Array:
    """All axes (k, 9) at ticks, the plainest way: it jumps in velocity, and keeps no limit.

    The tool goes straight from pose to pose at constant speed, the platform is carried along
    with it without a turn, and the arm's angles are found in closed form.

    Args:
        model: Of the robot.
        poses: (n, 4, 4) of the tool in odom.
        speed: Of the tool [m/s].
    """
    here = start()
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.arange(0.0, way[-1], speed * TICK)
    tool = poses[np.searchsorted(way, at, side="right") - 1]
    tool[:, :3, 3] = np.column_stack([np.interp(at, way, column) for column in poses[:, :3, 3].T])
    platform = np.tile(here[:3], (len(at), 1))
    platform[:, :2] += tool[:, :2, 3] - tool[0, :2, 3]
    branch = model.arm.branch_of(here[3:])
    return np.hstack([platform, model.arm_angles(platform, tool, branch, here[3:])])


def used(plan: ToolPlan, limits: BodyLimits) -> dict[str, Any]:
    """Largest share of a limit of the nine axes that a plan uses at a tick, and of which axis.

    Those of odom_x and odom_y hold for both as a vector.
    """
    curve, most = plan.curve, {}
    jerks = np.diff(curve.accelerations, axis=0) / TICK
    for name, values, bounds in (
        ("velocity", curve.velocities, limits.velocity),
        ("acceleration", curve.accelerations, limits.acceleration),
        ("jerk", jerks, limits.jerk),
    ):
        sizes = np.abs(values)
        sizes[:, :2] = np.hypot(values[:, 0], values[:, 1])[:, None]
        shares = (sizes / bounds).max(axis=0)
        k = int(shares.argmax())
        most[name] = {"share": float(shares[k]), "axis": "odom_xy" if k < 2 else limits.names[k]}
    return most


def quality(plan: ToolPlan, model: BodyModel) -> dict[str, float]:
    """How well the redundancy is used: manipulability, and how far the arm is stretched.

    Manipulability is |det J| of the arm alone, T. Yoshikawa, "Manipulability of Robotic
    Mechanisms" (1985), with lengths in metres.
    """
    q = plan.curve.positions
    manipulability = np.abs(np.linalg.det(model.arm.jacobian(q[:, 3:])))
    reach = np.linalg.norm(model.arm.forward(q[:, 3:])[:, :3, 3], axis=1)
    return {
        "least_manipulability": float(manipulability.min()),
        "first_manipulability": float(manipulability[0]),
        "largest_reach_m": float(reach.max()),
        "first_reach_m": float(reach[0]),
    }


def median_cpu(work: Callable[[], Any], repeats: int) -> float:
    """Median CPU time of a call [s]."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        work()
        times.append(time.process_time() - before)
    return statistics.median(times)


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body`; returns 0 if it could be measured, whatever the figures."""
    effort = QUICK if args.quick else FULL
    robot = resolved(args.robot)
    parameters = build(PathInterpolatorParameters, load_robot(robot))
    isolate(os.environ)
    bench = Bench(parameters)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "planning": {}}
    say("planning ...")
    for name in effort.courses:
        for count, length in SIZES.items():
            poses = course_poses(bench.model, name, length, count)
            result["planning"][f"{name} {count}"] = bench.figures(poses, effort.plans)
    say("previews ...")
    name, count = STREAMED
    poses = course_poses(bench.model, name, SIZES[count], count)
    plan = bench.plan(poses)
    result["preview_us"] = stream.previews(parameters, robot, plan, effort.blocks)
    say("inverse kinematics ...")
    result["inverse"] = inverse.measured(
        parameters.core.robot, parameters.arm, parameters.mount, effort.tries, effort.least
    )  # fmt: skip
    say(f"CPU of the nodes, twice {effort.seconds:g} s ...")
    result["cpu_share"] = stream.shares(robot, POSTURE, poses, effort.seconds)
    say("\n".join(report(result)))
    results.publish("bench_whole_body", result, args.results)
    return 0


def report(result: dict[str, Any]) -> list[str]:
    """The table at the end."""
    rows: list[tuple[str, ...]] = [("", "value", "next to it")]
    for label, row in result["planning"].items():
        rows += _plan_rows(label, row)
    rows += _stream_rows(result["preview_us"], result["cpu_share"])
    rows += inverse.rows(result["inverse"])
    return ["", *table(rows), ""]


def _plan_rows(label: str, row: dict[str, Any]) -> list[tuple[str, ...]]:
    name, count = label.split()
    parts = ", ".join(f"{part} {taken:.0f}" for part, taken in row["parts_ms"].items())
    limits = ", ".join(
        f"{kind} {100.0 * most['share']:.0f} % ({most['axis']})"
        for kind, most in row["limits_used"].items()
    )
    return [
        (f"planning, {name} of {row['length_m']:.1f} m, {int(count):,} poses, CPU",
         f"{row['planning_ms']:.0f} ms", f"{parts} ms"),
        ("  plain resampling, which jumps in velocity", f"{row['plain_resampling_ms']:.1f} ms",
         f"{row['ratio']:.0f} times as fast"),
        ("  duration", f"{row['duration_s']:.2f} s",
         f"{row['duration_ratio']:.3f} of length / linear_velocity"),
        ("  of the axes' limits used at most", "", limits),
        ("  least manipulability of the arm", f"{row['least_manipulability']:.4f}",
         f"{row['first_manipulability']:.4f} at the start"),
        ("  tool from the arm's base at most", f"{row['largest_reach_m']:.3f} m",
         f"{row['first_reach_m']:.3f} m at the start"),
    ]  # fmt: skip


def _stream_rows(preview: dict[str, Any], share: dict[str, Any]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, text in (("arm", "preview of the arm"), ("both", "preview of platform and arm")):
        row = preview[name]
        rows.append(
            (f"{text}, corrected", f"{row['corrected']:.0f} us",
             f"{row['planned']:.0f} us as planned, not corrected")
        )  # fmt: skip
        rows.append(
            ("  and in its messages; published by the node",
             f"{row['and_filled']:.0f}; {row['and_published']:.0f} us", "")
        )  # fmt: skip
    rows.append(("a pose of odom, heard", f"{preview['hear_odom']:.0f} us", ""))
    tick = preview["tick"]
    rows.append(
        (f"CPU time of a streamed tick of {1e3 * TICK:g} ms, computed from these",
         f"{tick['and_published']:.0f} us",
         f"{tick['corrected']:.0f} without messages; arm at {stream.ARM_RATE:g} Hz")
    )  # fmt: skip
    for name, driving in share["driving"].items():
        rows.append(
            (f"share of a core, {name}", f"{100.0 * driving:.1f} %",
             f"{100.0 * share['idle'][name]:.1f} % at rest")
        )  # fmt: skip
    rows.append(
        ("CPU time of a streamed tick, all of path_interpolator",
         f"{share['cpu_per_tick_us']:.0f} us", f"{share['previews_per_s']:.0f} previews a second")
    )  # fmt: skip
    return rows
