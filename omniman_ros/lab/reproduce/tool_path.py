"""`omniman reproduce tool_path`: where the tool is, with and without the arm's correction."""

import argparse
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.lab.reproduce.pipeline import collect, publish
from omniman_ros.lab.studies.tool_courses import COURSES, start, tool_poses
from omniman_ros.lab.studies.tool_path import HARSHEST, WHEELS, Case, Run, ToolPathLoop, rms
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.robots import load_robot
from omniman_ros.simulation.ur.arm import SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.motion import ServoJ, Target
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.setpoint_generator import GeneratorSettings, JointSetpointGenerator
from omniman_ros.ur.streaming_supervisor import joint_limits

NAME = "reproduce_tool_path"
RMS_BOUND = 0.002
"""Bound of the RMS distance of the tool from the timed point of its path, in odom [m]."""
MAX_BOUND = 0.005
"""Bound of the largest distance of the tool from the timed point of its path, in odom [m]."""
LENGTH = 4.0
"""Length of the tool's path in the plane [m]."""
QUICK_LENGTH = 1.0
"""Length of the tool's path in the plane, in a quick run [m]."""


class StreamedArm:
    """The streamer's setpoints and the simulated controller's servo, directly connected.

    Args:
        angles: (6,) joint angles at rest [rad].
        arm: Parameters of the arm.
        ur: Parameters of the streamer.
    """

    period = PERIOD

    def __init__(self, angles: Array, arm: ArmParameters, ur: UrParameters) -> None:
        self._ur = ur
        settings = GeneratorSettings(ur.start_distance, ur.servo_lag)
        self._stream = JointSetpointGenerator(joint_limits(arm, ur), settings, PERIOD)
        self._stream.begin(angles, 0.0)
        self._arm = SimulatedArm(UrArmParameters(initial=tuple(angles.tolist())))
        self._target = Target(angles.copy())

    def preview(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array, now: float
    ) -> None:
        """Follow a preview of the joints; see :meth:`JointSetpointGenerator.preview`."""
        self._stream.follow(JointPreview(times, positions, velocities, accelerations), now)

    def cycle(self, now: float) -> Array:
        """Send a setpoint at a time [s] and servo for a period; return the joint angles (6,)."""
        setpoint = self._stream.tick(now, self._arm.q)
        servo = ServoJ(setpoint, PERIOD, self._ur.lookahead_time, self._ur.gain)
        servo.advance(self._target, PERIOD)
        self._arm.follow(self._target.q, PERIOD)
        return self._arm.q


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce tool_path`; return 1 if a bound was missed, else 0."""
    robot = load_robot(args.robot)
    length = QUICK_LENGTH if args.quick else LENGTH
    todo = cases(args.quick, args.seed)
    speed = options(True).linear_velocity
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"tool0 along paths of {length:g} m at {speed:g} m/s with platform and arm in step: "
        f"{len(todo)} drives, robot '{args.robot}'"
    )
    with ProcessPoolExecutor(min(len(todo), os.cpu_count() or 1)) as pool:
        made = pool.map(partial(drive, dict(robot), length), todo)
        runs = collect(progress, "drives", made, len(todo), "drives")
    rows = [row_of(driven) for driven in runs]
    result: dict[str, Any] = {
        "robot": args.robot,
        "quick": args.quick,
        "seed": args.seed,
        "length_m": length,
        "speed_m_s": speed,
        "bounds": {"rms_mm": 1e3 * RMS_BOUND, "max_mm": 1e3 * MAX_BOUND},
        "drives": rows,
        "passed": all(row["kept"] for row in rows if row["correction"]),
    }
    picture = draw(runs, Path(args.results))
    result["picture"] = picture and str(picture)
    publish(NAME, result, report, started, args.results)
    return 0 if result["passed"] else 1


def cases(quick: bool, seed: int) -> list[tuple[str, Case]]:
    """Return course and case of each drive, each with correction before the same without."""
    courses = ["S"] if quick else list(COURSES)
    wheels = [HARSHEST] if quick else list(WHEELS)
    return [
        (course, WHEELS[name].case(options(on), seed))
        for course in courses
        for name in wheels
        for on in (True, False)
    ]


def options(correction: bool) -> ToolPathOptions:
    """Return the default options, with the correction or without."""
    return build(ToolPathOptions, {"correction": correction})


def drive(robot: Mapping[str, Any], length: float, todo: tuple[str, Case]) -> Run:
    """Drive once.

    Args:
        robot: Parameters of the robot, full names to values.
        length: Length of the tool's path in the plane [m].
        todo: Course and case.

    Raises:
        StudyError: The drive did not come to its end.
    """
    course, case = todo
    model = WholeBodyModel(build(Mount, {}))
    joints = ArmParameters()
    limits = WholeBodyLimits.of_whole_body(build(PathParameters, robot), joints)
    motion = ToolPlanner(model, limits, case.options).plan(
        tool_poses(model, course, length), start()
    )
    arm = StreamedArm(motion.curve.positions[0, 3:], joints, UrParameters())
    return ToolPathLoop(robot, case, course, motion, model, arm).run()


def row_of(run: Run) -> dict[str, Any]:
    """Return the figures of a drive."""
    error, true_error = run.error, run.true_error
    distance = np.hypot(run.platform[:, 0], run.platform[:, 1])
    return {
        "course": run.course,
        "wheels": run.case.about,
        "correction": run.case.options.correction,
        "rms_mm": 1e3 * rms(error),
        "max_mm": 1e3 * float(error.max()),
        "turned_rms_mrad": 1e3 * rms(run.turned),
        "turned_max_mrad": 1e3 * float(run.turned.max()),
        "truth_rms_mm": 1e3 * rms(true_error),
        "truth_max_mm": 1e3 * float(true_error.max()),
        "platform_rms_mm": 1e3 * rms(distance),
        "platform_heading_rms_mrad": 1e3 * rms(run.platform[:, 2]),
        "kept": bool(rms(error) <= RMS_BOUND and error.max() <= MAX_BOUND),
    }


def draw(runs: Sequence[Run], folder: Path) -> Path | None:
    """Draw the study into a PNG file if matplotlib is installed."""
    try:
        from omniman_ros.lab.figures import tool_path as tool_path_picture
    except ImportError:
        return None
    path = folder / f"{NAME}.png"
    tool_path_picture.draw(runs, RMS_BOUND, MAX_BOUND, path)
    return path


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the table."""
    rows: list[tuple[str, ...]] = [
        (
            "path, wheels",
            "correction",
            "tool RMS",
            "max",
            "turned",
            "truth RMS",
            "max",
            "platform RMS",
            "heading",
        )
    ]
    rows += [
        (
            f"{row['course']}, {row['wheels']}",
            "on" if row["correction"] else "off",
            f"{row['rms_mm']:.2f}",
            f"{row['max_mm']:.2f} mm",
            f"{row['turned_rms_mrad']:.2f} mrad",
            f"{row['truth_rms_mm']:.2f}",
            f"{row['truth_max_mm']:.2f} mm",
            f"{row['platform_rms_mm']:.2f} mm",
            f"{row['platform_heading_rms_mrad']:.2f} mrad",
        )
        for row in result["drives"]
    ]
    bounds = result["bounds"]
    kept = verdict(result["passed"], "kept")
    lines = [
        "",
        "tool0 off the timed point of its path, in odom; the same in the world:",
        *table(rows),
        "",
        f"With correction within {bounds['rms_mm']:g} mm RMS and {bounds['max_mm']:g} mm: {kept}",
    ]
    if result["picture"]:
        lines.append(f"Picture: {result['picture']}")
    return lines
