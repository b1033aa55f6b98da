"""`omniman reproduce tool_path`: error of the tool on its path, with and without correction.

Platform and arm move together along a path of `tool0`. The correction lets the arm compensate for
the tracking error of the platform.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.reproduce.pipeline import Experiment, columns
from omniman_ros.lab.studies.tool_courses import COURSES, start, tool_poses
from omniman_ros.lab.studies.tool_path import (
    MOST_DEMANDING,
    WHEELS,
    StreamedArm,
    ToolPathCase,
    ToolPathLoop,
    ToolPathRun,
    rms,
)
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.sweep import Sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.processes.arm_options import WORLD_SERVO_LAG
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.arm_link.direct_link import DirectLink
from omniman_ros.simulation.ur.arm import SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.arm_body import ArmBody
from omniman_ros.simulation.ur.world_arm import WorldArm
from omniman_ros.ur.parameters import UrParameters

RMS_BOUND, MAX_BOUND = 0.002, 0.005
"""Bounds of the distance of the tool from its reference position at each time, in odom [m]."""
LENGTH, QUICK_LENGTH = 4.0, 1.0  #: lengths of the tool's path, projected onto the floor [m]


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce tool_path`.

    Returns:
        1 if a drive with correction exceeds a bound, else 0.
    """
    robot, selected = robot_parameters(args.robot), cases(args.quick, args.seed)
    length = QUICK_LENGTH if args.quick else LENGTH
    speed = options(True).linear_velocity
    experiment = Experiment(
        args,
        f"tool0 along paths of {length:g} m at {speed:g} m/s, platform and arm together: "
        f"{len(selected)} drives",
    )
    driven = Sweep.here().map(partial(drive, dict(robot), length, args.world), selected)
    runs = experiment.collect(driven, len(selected))
    rows = [drive_row(each) for each in runs]
    passed = all(row["kept"] for row in rows if row["correction"])
    result = {
        "length_m": length,
        "speed_m_s": speed,
        "bounds": {"rms_mm": 1e3 * RMS_BOUND, "max_mm": 1e3 * MAX_BOUND},
        "drives": rows,
        "passed": passed,
        "picture": experiment.picture(
            lambda f, path: f.draw_tool_path(runs, RMS_BOUND, MAX_BOUND, path)
        ),
    }
    experiment.publish(result, report)
    return 0 if passed else 1


def cases(quick: bool, seed: int) -> list[ToolPathCase]:
    """Return the drives: each course on each kind of wheels with the correction, then without."""
    courses = ["S"] if quick else list(COURSES)
    wheels = [MOST_DEMANDING] if quick else list(WHEELS)
    return [
        ToolPathCase(course, WHEELS[name], options(correction), seed)
        for course in courses
        for name in wheels
        for correction in (True, False)
    ]


def options(correction: bool) -> ToolPathOptions:
    """Return the default options of tool paths, with the correction on or off."""
    return build(ToolPathOptions, {"correction": correction})


def drive(
    robot: Mapping[str, Any], length: float, wheels: str | None, case: ToolPathCase
) -> ToolPathRun:
    """Plan and drive one tool path."""
    model = WholeBodyModel(build(Mount, {}))
    joints = ArmParameters()
    limits = WholeBodyLimits.of_whole_body(build(PathParameters, robot), joints)
    motion = ToolPlanner(model, limits, case.options).plan(
        tool_poses(model, case.course, length), start()
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
    return ToolPathLoop(platform, case, motion, model, arm).run()


def drive_row(run: ToolPathRun) -> dict[str, Any]:
    """Return the figures of a drive for the JSON, with the units in their names.

    The drive is `kept` if its errors in odom keep both bounds.
    """
    error, true_error = run.error, run.true_error
    distance = np.hypot(run.platform[:, 0], run.platform[:, 1])
    return {
        "course": run.case.course,
        "wheels": run.case.wheels.about,
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


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    bounds = result["bounds"]
    return [
        "",
        "Distance of tool0 from its reference position, in odom; true: in the world:",
        *columns(
            result["drives"],
            ("path, wheels", "{course}, {wheels}"),
            ("correction", lambda row: "on" if row["correction"] else "off"),
            ("tool RMS", "{rms_mm:.2f}"),
            ("max", "{max_mm:.2f} mm"),
            ("orientation", "{turned_rms_mrad:.2f} mrad"),
            ("true RMS", "{truth_rms_mm:.2f}"),
            ("true max", "{truth_max_mm:.2f} mm"),
            ("platform RMS", "{platform_rms_mm:.2f} mm"),
            ("heading", "{platform_heading_rms_mrad:.2f} mrad"),
        ),
        "",
        f"With correction within {bounds['rms_mm']:g} mm RMS and {bounds['max_mm']:g} mm: "
        f"{verdict(result['passed'], 'kept')}",
    ]
