"""`omniman reproduce tool_path`: error of the tool on its path, with and without correction.

Platform and arm move together along a path of `tool0`. The correction lets the arm compensate for
the tracking error of the platform.
"""

import argparse
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.reproduce.pipeline import collect, publish, result_name
from omniman_ros.lab.studies.tool_courses import COURSES, start, tool_poses
from omniman_ros.lab.studies.tool_path import (
    MOST_DEMANDING,
    WHEELS,
    Case,
    Run,
    StreamedArm,
    ToolPathLoop,
    rms,
)
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.processes.arm_options import WORLD_SERVO_LAG
from omniman_ros.robots import load_robot
from omniman_ros.simulation.arm_link.direct_link import DirectLink
from omniman_ros.simulation.ur.arm import SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.arm_body import ArmBody
from omniman_ros.simulation.ur.world_arm import WorldArm
from omniman_ros.ur.parameters import UrParameters

RMS_BOUND = 0.002
"""Bound of the RMS distance of the tool from its reference position at each time, in odom [m]."""
MAX_BOUND = 0.005
"""Bound of the largest distance of the tool from its reference position, in odom [m]."""
LENGTH = 4.0  # length of the tool's path, projected onto the floor [m]
QUICK_LENGTH = 1.0  # length of the tool's path in a quick run, projected onto the floor [m]


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce tool_path`.

    Returns:
        1 if a drive with correction exceeds a bound, else 0.
    """
    robot = load_robot(args.robot)
    length = QUICK_LENGTH if args.quick else LENGTH
    selected = cases(args.quick, args.seed)
    speed = options(True).linear_velocity
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"tool0 along paths of {length:g} m at {speed:g} m/s, platform and arm together: "
        f"{len(selected)} drives, robot '{args.robot}'"
        + (f", in the physics world on wheels '{args.world}'" if args.world else "")
    )
    with ProcessPoolExecutor(min(len(selected), os.cpu_count() or 1)) as pool:
        generator = pool.map(partial(drive, dict(robot), length, args.world), selected)
        runs = collect(progress, "drives", generator, len(selected), "drives")
    rows = [drive_row(driven) for driven in runs]
    result: dict[str, Any] = {
        "robot": args.robot,
        "world": args.world,
        "quick": args.quick,
        "seed": args.seed,
        "length_m": length,
        "speed_m_s": speed,
        "bounds": {"rms_mm": 1e3 * RMS_BOUND, "max_mm": 1e3 * MAX_BOUND},
        "drives": rows,
        "passed": all(row["kept"] for row in rows if row["correction"]),
    }
    name = result_name("tool_path", args.world)
    picture = draw(runs, Path(args.results) / f"{name}.png")
    result["picture"] = picture and str(picture)
    publish(name, result, report, started, args.results)
    return 0 if result["passed"] else 1


def cases(quick: bool, seed: int) -> list[tuple[str, Case]]:
    """Return the course and the case of each drive.

    Each combination of course and wheels is driven with the correction first, then without.
    """
    courses = ["S"] if quick else list(COURSES)
    wheels = [MOST_DEMANDING] if quick else list(WHEELS)
    return [
        (course, WHEELS[name].case(options(correction), seed))
        for course in courses
        for name in wheels
        for correction in (True, False)
    ]


def options(correction: bool) -> ToolPathOptions:
    """Return the default options of tool paths, with the correction on or off."""
    return build(ToolPathOptions, {"correction": correction})


def drive(
    robot: Mapping[str, Any],
    length: float,
    wheels: str | None,
    course_and_case: tuple[str, Case],
) -> Run:
    """Plan and drive one tool path."""
    course, case = course_and_case
    model = WholeBodyModel(build(Mount, {}))
    joints = ArmParameters()
    limits = WholeBodyLimits.of_whole_body(build(PathParameters, robot), joints)
    motion = ToolPlanner(model, limits, case.options).plan(
        tool_poses(model, course, length), start()
    )
    angles = tuple(motion.curve.positions[0, 3:].tolist())
    parameters, ur = UrArmParameters(initial=angles), UrParameters()
    body: ArmBody
    if wheels is None:
        platform, body = case.platform(robot), SimulatedArm(parameters)
    else:
        platform = case.platform(robot, WorldChoice.of(robot, wheels, posture=angles))
        assert platform.world is not None and platform.world.arm is not None
        body = WorldArm(parameters, DirectLink(platform.world.arm), is_lockstep=True)
        body.measure(0.0)
        ur = replace(ur, servo_lag=WORLD_SERVO_LAG)
    arm = StreamedArm(body, joints, ur)
    return ToolPathLoop(platform, case, course, motion, model, arm).run()


def drive_row(run: Run) -> dict[str, Any]:
    """Return the figures of a drive for the JSON, with the units in their names.

    The drive is `kept` if its errors in odom keep both bounds.
    """
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


def draw(runs: Sequence[Run], path: Path) -> Path | None:
    """Draw the drives as a PNG file; return its path, or None if matplotlib is not installed."""
    try:
        from omniman_ros.lab.figures import tool_path as tool_path_picture
    except ImportError:
        return None
    tool_path_picture.draw(runs, RMS_BOUND, MAX_BOUND, path)
    return path


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    rows: list[tuple[str, ...]] = [
        (
            "path, wheels",
            "correction",
            "tool RMS",
            "max",
            "orientation",
            "true RMS",
            "true max",
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
    outcome = verdict(result["passed"], "kept")
    lines = [
        "",
        "Distance of tool0 from its reference position, in odom; true: in the world:",
        *table(rows),
        "",
        f"With correction within {bounds['rms_mm']:g} mm RMS and {bounds['max_mm']:g} mm: "
        f"{outcome}",
    ]
    if result["picture"]:
        lines.append(f"Picture: {result['picture']}")
    return lines
