"""`omniman bench whole_body`: planning and streaming of tool paths, inverse kinematics.

All times are CPU times of this process or of the running nodes, as the machine may be busy with
other work.
"""

import argparse
import os
import statistics
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench import whole_body_inverse as inverse
from omniman_ros.lab.bench import whole_body_stream as stream
from omniman_ros.lab.bench.harness import Rows, conclude, cpu_share_rows, tables
from omniman_ros.lab.measurement import median_cpu
from omniman_ros.lab.studies.tool_courses import COURSES, POSTURE, start
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.motion.whole_body.posture import PostureResolver
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.motion.whole_body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.motion.whole_body.tool_timing import ToolTimer
from omniman_ros.motion.whole_body.whole_body_path import WholeBodyPath
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import load_robot

PATH_LENGTHS = {100: 4.0, 10_000: 12.0}
"""Lengths of the paths in the plane, by their number of poses [m]."""
STREAMED = ("circle", 10_000)
"""Name of the course, and number of poses, of the path whose previews are measured."""


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement."""

    courses: tuple[str, ...]  # names of the courses of the paths
    plans: int  # number of plans of each path
    blocks: int  # number of blocks of previews
    tries: int  # number of poses for which each iterative solver solves
    min_block_time: float  # shortest CPU time of a block of calls of the closed form [s]
    seconds: float  # time for which the nodes are measured, once at rest and once driving [s]


FULL = Effort(tuple(COURSES), plans=7, blocks=9, tries=300, min_block_time=0.3, seconds=12.0)
"""Extent without options."""
QUICK = Effort(("circle",), plans=1, blocks=2, tries=10, min_block_time=0.01, seconds=2.0)
"""Extent with `--quick`."""


class PlanningBench:
    """Plans tool paths of a robot and measures the planning."""

    def __init__(self, parameters: PathInterpolatorParameters) -> None:
        p = parameters
        self._options = p.tool_path
        self.model = WholeBodyModel(p.mount)
        self.limits = WholeBodyLimits.of_whole_body(p.core, p.arm)
        self._planner = ToolPlanner(self.model, self.limits, p.tool_path)
        self._resolver = PostureResolver(self.model, self.limits, p.tool_path)
        self._timer = ToolTimer(self.limits, p.tool_path)

    def plan(self, poses: Array) -> ToolPlan:
        """Return the plan of a tool path from the start of the courses.

        Args:
            poses: (k, 4, 4) poses of the tool in odom, lengths in metres.
        """
        return self._planner.plan(poses, start())

    def figures(self, poses: Array, repeats: int) -> dict[str, Any]:
        """Measure the CPU time of planning a tool path, and the quality of the plan.

        Args:
            poses: (k, 4, 4) poses of the tool in odom, lengths in metres.

        Returns:
            CPU times of planning, in total and by parts, and figures of the plan.
        """
        plan = self.plan(poses)
        cpu_time = median_cpu(lambda: self.plan(poses), repeats)
        speed = self._options.linear_velocity
        parts = self._parts(poses, repeats)
        parts["checks"] = max(1e3 * cpu_time - sum(parts.values()), 0.0)
        plain = median_cpu(lambda: resampled(self.model, poses, speed), repeats)
        shortest = plan.length / speed
        return {
            "planning_ms": 1e3 * cpu_time,
            "parts_ms": parts,
            "plain_resampling_ms": 1e3 * plain,
            "ratio": cpu_time / plain,
            "length_m": plan.length,
            "duration_s": plan.curve.duration,
            "duration_ratio": plan.curve.duration / shortest,
            "limits_used": limits_used(plan, self.limits),
            **quality(plan, self.model),
        }

    def _parts(self, poses: Array, repeats: int) -> dict[str, float]:
        """Return the median CPU time of each part of planning except the checks [ms]."""
        times: dict[str, list[float]] = {"curve": [], "postures": [], "timing": []}
        here = start()
        frame = planar_transform(here[:3])
        all_poses = np.linalg.inv(frame) @ np.concatenate([self.model.forward(here)[None], poses])
        branch = self.model.arm.branch_of(here[3:])
        for _ in range(repeats):
            marks = [time.process_time()]
            path = ToolCurve(all_poses, self._options, frame)
            marks.append(time.process_time())
            local = np.concatenate([np.zeros(len(PLATFORM_AXES)), here[3:]])
            postures = self._resolver.resolve(path, local)
            marks.append(time.process_time())
            self._timer.timed(WholeBodyPath(self.model, path, postures, branch))
            marks.append(time.process_time())
            for name, cpu_time in zip(times, np.diff(marks).tolist(), strict=True):
                times[name].append(1e3 * cpu_time)
        return {name: statistics.median(values) for name, values in times.items()}


def course_poses(model: WholeBodyModel, name: str, length: float, count: int) -> Array:
    """Return equidistant poses of the tool along a course, from the start of the courses.

    Args:
        length: Length of the path in the plane [m].

    Returns:
        (count, 4, 4) poses of the tool in odom, lengths in metres.
    """
    course = COURSES[name](np.linspace(0.0, length, count), length)
    poses = np.tile(model.forward(start()), (count, 1, 1))
    poses[:, :3, 3] += course[:, :3]
    turn = planar_transform(np.column_stack([np.zeros((count, 2)), course[:, 3]]))[:, :3, :3]
    poses[:, :3, :3] = turn @ poses[:, :3, :3]
    return poses


def resampled(model: WholeBodyModel, poses: Array, speed: float) -> Array:
    """Resample a tool path at constant speed, with jumps in velocity and without any limits.

    This is the plainest interpolation possible, the baseline of the planning time. The tool moves
    straight from pose to pose, the platform moves with it without turning, and the joint angles
    follow from the inverse kinematics in closed form.

    Args:
        poses: (n, 4, 4) poses of the tool in odom, lengths in metres.
        speed: Speed of the tool [m/s].

    Returns:
        (k, 9) positions of all axes at 125 Hz: platform [m, m, rad], joints [rad].
    """
    here = start()
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.arange(0.0, distance[-1], speed * TICK)
    tool = poses[np.searchsorted(distance, at, side="right") - 1]
    tool[:, :3, 3] = np.column_stack(
        [np.interp(at, distance, column) for column in poses[:, :3, 3].T]
    )
    platform = np.tile(here[:3], (len(at), 1))
    platform[:, :2] += tool[:, :2, 3] - tool[0, :2, 3]
    branch = model.arm.branch_of(here[3:])
    return np.hstack([platform, model.arm_angles(platform, tool, branch, here[3:])])


def limits_used(plan: ToolPlan, limits: WholeBodyLimits) -> dict[str, Any]:
    """Return the largest share of the limits that a plan uses, and the axis that uses it.

    The limits of odom_x and odom_y hold for the magnitude of both as a vector.

    Returns:
        Share and axis for each of velocity, acceleration and jerk.
    """
    curve, largest = plan.curve, {}
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
        largest[name] = {
            "share": float(shares[k]),
            "axis": "odom_xy" if k < 2 else limits.names[k],
        }
    return largest


def quality(plan: ToolPlan, model: WholeBodyModel) -> dict[str, float]:
    """Return figures of how well a plan uses the redundancy: the arm's manipulability and reach.

    Manipulability is |det J| of the arm alone with lengths in metres, after T. Yoshikawa,
    "Manipulability of Robotic Mechanisms" (1985). The reach is the distance of the tool from the
    arm's base.
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


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body`; return 0, the exit code of a successful measurement."""
    effort = QUICK if args.quick else FULL
    robot = resolve_robot(args.robot)
    parameters = build(PathInterpolatorParameters, load_robot(robot))
    isolate_ros_domain(os.environ)
    bench = PlanningBench(parameters)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "planning": {}}
    say("planning ...")
    for name in effort.courses:
        for count, length in PATH_LENGTHS.items():
            poses = course_poses(bench.model, name, length, count)
            result["planning"][f"{name} {count}"] = bench.figures(poses, effort.plans)
    say("previews ...")
    name, count = STREAMED
    poses = course_poses(bench.model, name, PATH_LENGTHS[count], count)
    plan = bench.plan(poses)
    result["preview_us"] = stream.measure_previews(parameters, robot, plan, effort.blocks)
    say("inverse kinematics ...")
    result["inverse"] = inverse.measure(
        parameters.core.robot,
        parameters.arm,
        parameters.mount,
        effort.tries,
        effort.min_block_time,
    )
    say(f"CPU of the nodes, twice {effort.seconds:g} s ...")
    result["cpu_share"] = stream.measure_shares(robot, POSTURE, poses, effort.seconds)
    return conclude("whole_body", result, report, args.results)


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [("", "value", "compared with")]
    for label, row in result["planning"].items():
        rows += _plan_rows(label, row)
    rows += _stream_rows(result["preview_us"], result["cpu_share"])
    rows += inverse.rows(result["inverse"])
    return tables(rows)


def _plan_rows(label: str, row: dict[str, Any]) -> Rows:
    name, count = label.split()
    parts = ", ".join(f"{part} {cpu_time:.0f}" for part, cpu_time in row["parts_ms"].items())
    limits = ", ".join(
        f"{kind} {100.0 * usage['share']:.0f} % ({usage['axis']})"
        for kind, usage in row["limits_used"].items()
    )
    return [
        (
            f"planning, {name} of {row['length_m']:.1f} m, {int(count):,} poses, CPU",
            f"{row['planning_ms']:.0f} ms",
            f"{parts} ms",
        ),
        (
            "  plain resampling, which jumps in velocity",
            f"{row['plain_resampling_ms']:.1f} ms",
            f"planning takes {row['ratio']:.0f} times as long",
        ),
        (
            "  duration",
            f"{row['duration_s']:.2f} s",
            f"{row['duration_ratio']:.3f} of length / linear_velocity",
        ),
        ("  largest share of a limit that is used", "", limits),
        (
            "  smallest manipulability of the arm",
            f"{row['least_manipulability']:.4f}",
            f"{row['first_manipulability']:.4f} at the start",
        ),
        (
            "  largest distance of the tool from the arm's base",
            f"{row['largest_reach_m']:.3f} m",
            f"{row['first_reach_m']:.3f} m at the start",
        ),
    ]


def _stream_rows(preview: dict[str, Any], share: dict[str, Any]) -> Rows:
    rows: Rows = []
    for name, text in (("arm", "preview of the arm"), ("both", "preview of platform and arm")):
        row = preview[name]
        rows.append(
            (
                f"CPU time of a {text}, corrected",
                f"{row['corrected']:.0f} us",
                f"{row['planned']:.0f} us without correction",
            )
        )
        rows.append(
            (
                "  including its messages; published by the node",
                f"{row['and_filled']:.0f}; {row['and_published']:.0f} us",
                "",
            )
        )
    rows.append(
        ("CPU time of processing a message on odom", f"{preview['receive_odom']:.0f} us", "")
    )
    tick = preview["tick"]
    rows.append(
        (
            f"CPU time per streamed tick of {1e3 * TICK:g} ms, computed from the above",
            f"{tick['and_published']:.0f} us",
            f"{tick['corrected']:.0f} us without messages; arm at {stream.ARM_RATE:g} Hz",
        )
    )
    rows += cpu_share_rows(share, "at rest")
    rows.append(
        (
            "CPU time per streamed tick, path_interpolator as a whole",
            f"{share['cpu_per_tick_us']:.0f} us",
            f"{share['previews_per_s']:.0f} previews per second",
        )
    )
    return rows
