"""`omniman reproduce tool_path`: where the tool is, with and without the arm's correction."""

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.arm.parameters import PERIOD, UrParameters
from omniman_ros.arm.stream import JointStream, StreamSettings
from omniman_ros.arm.streamer import joint_limits
from omniman_ros.cli import results
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.terminal import GREEN, RED, paint, say, table
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import BodyModel, Mount
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.body.tool_planner import ToolPlanner
from omniman_ros.core.parameters import build
from omniman_ros.core.path.parameters import PathParameters
from omniman_ros.robots import load_robot
from omniman_ros.simulated_ur.arm import Arm, UrArmParameters
from omniman_ros.simulated_ur.motion import ServoJ, Target
from omniman_ros.studies.tool_courses import COURSES, start, tool_poses
from omniman_ros.studies.tool_path import HARSHEST, WHEELS, Case, Run, ToolPathLoop, rms

Array = NDArray[np.float64]

NAME = "reproduce_tool_path"
RMS_BOUND, MAX_BOUND = 0.002, 0.005
"""Of the tool off the timed point of its path, in odom [m]."""
LENGTH, QUICK_LENGTH = 4.0, 1.0
"""Of the tool's way in the plane [m]."""


class StreamedArm:
    """The streamer's setpoints and the simulated controller's servo, without what lies between.

    Args:
        angles: (6,) where it is at rest [rad].
        arm, ur: Parameters.
    """

    period = PERIOD

    def __init__(self, angles: Array, arm: ArmParameters, ur: UrParameters) -> None:
        self._ur = ur
        settings = StreamSettings(ur.start_distance, ur.servo_lag)
        self._stream = JointStream(joint_limits(arm, ur), settings, PERIOD)
        self._stream.begin(angles, 0.0)
        self._arm = Arm(UrArmParameters(initial=tuple(angles.tolist())))
        self._target = Target(angles.copy())

    def preview(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array, now: float
    ) -> None:
        """Take a preview of the joints; see :meth:`JointStream.preview`."""
        self._stream.preview(JointPreview(times, positions, velocities, accelerations), now)

    def cycle(self, now: float) -> Array:
        """Send a setpoint at a time [s], servo for a period; the joint angles (6,) [rad] then."""
        setpoint = self._stream.tick(now, self._arm.q)
        servo = ServoJ(setpoint, PERIOD, self._ur.lookahead_time, self._ur.gain)
        servo.advance(self._target, PERIOD)
        self._arm.follow(self._target.q, PERIOD)
        return self._arm.q


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce tool_path`; returns 1 if a bound was missed, else 0."""
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
    progress.begin("drives")
    runs: list[Run] = []
    with ProcessPoolExecutor(min(len(todo), os.cpu_count() or 1)) as pool:
        for driven in pool.map(partial(drive, dict(robot), length), todo):
            runs.append(driven)
            progress.update(len(runs) / len(todo), f"{len(runs)} of {len(todo)}")
    progress.end(f"{len(runs)} drives")
    rows = [row_of(driven) for driven in runs]
    result: dict[str, Any] = {
        "robot": args.robot, "quick": args.quick, "seed": args.seed, "length_m": length,
        "speed_m_s": speed, "bounds": {"rms_mm": 1e3 * RMS_BOUND, "max_mm": 1e3 * MAX_BOUND},
        "drives": rows, "passed": all(row["kept"] for row in rows if row["correction"]),
    }  # fmt: skip
    picture = draw(runs, Path(args.results))
    result["picture"] = picture and str(picture)
    result["took_s"] = time.monotonic() - started
    say("\n".join(report(result)))
    results.publish(NAME, result, args.results)
    return 0 if result["passed"] else 1


def cases(quick: bool, seed: int) -> list[tuple[str, Case]]:
    """Course and case of each drive, those without correction after those with it."""
    courses = ["S"] if quick else list(COURSES)
    wheels = [HARSHEST] if quick else list(WHEELS)
    return [
        (course, WHEELS[name].case(options(on), seed))
        for course in courses
        for name in wheels
        for on in (True, False)
    ]


def options(correction: bool) -> ToolPathOptions:
    """The defaults, with the correction or without."""
    return build(ToolPathOptions, {"correction": correction})


def drive(robot: Mapping[str, Any], length: float, todo: tuple[str, Case]) -> Run:
    """Drive once; raises StudyError if something gives up."""
    course, case = todo
    model = BodyModel(build(Mount, {}))
    joints = ArmParameters()
    limits = BodyLimits.of_body(build(PathParameters, robot), joints)
    motion = ToolPlanner(model, limits, case.options).plan(
        tool_poses(model, course, length), start()
    )
    arm = StreamedArm(motion.curve.positions[0, 3:], joints, UrParameters())
    return ToolPathLoop(robot, case, course, motion, model, arm).run()


def row_of(run: Run) -> dict[str, Any]:
    """What is published of a drive."""
    error, true_error = run.error, run.true_error
    away = np.hypot(run.platform[:, 0], run.platform[:, 1])
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
        "platform_rms_mm": 1e3 * rms(away),
        "platform_heading_rms_mrad": 1e3 * rms(run.platform[:, 2]),
        "kept": bool(rms(error) <= RMS_BOUND and error.max() <= MAX_BOUND),
    }


def draw(runs: Sequence[Run], folder: Path) -> Path | None:
    """Draw the study into a PNG file, where there is matplotlib."""
    try:
        from omniman_ros.cli import tool_path_picture
    except ImportError:
        return None
    path = folder / f"{NAME}.png"
    tool_path_picture.draw(runs, RMS_BOUND, MAX_BOUND, path)
    return path


def report(result: Mapping[str, Any]) -> list[str]:
    """The table at the end."""
    rows: list[tuple[str, ...]] = [
        ("path, wheels", "correction", "tool RMS", "max", "turned", "truth RMS", "max",
         "platform RMS", "heading")
    ]  # fmt: skip
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
    kept = (
        paint("kept", GREEN, sys.stdout) if result["passed"] else paint("MISSED", RED, sys.stdout)
    )
    lines = [
        "", "tool0 off the timed point of its path, in odom; the same in the world:", *table(rows),
        "", f"With correction within {bounds['rms_mm']:g} mm RMS and {bounds['max_mm']:g} mm: "
        f"{kept}",
    ]  # fmt: skip
    if result["picture"]:
        lines.append(f"Picture: {result['picture']}")
    return lines
