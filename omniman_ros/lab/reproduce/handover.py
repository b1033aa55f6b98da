"""`omniman reproduce handover`: two robots meet in motion, drive side by side, and part again.

MPC 2021, 5, proposes it: a load could be transferred between two robots that move in parallel. In
the physics world, the odometry of both is calibrated first, as neither sees what rollers take.
"""

import argparse
import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.reproduce.pipeline import Experiment, columns
from omniman_ros.lab.studies.calibration import calibrate
from omniman_ros.lab.studies.handover import (
    HANDOVER_WHEELS,
    KEPT_TIME,
    LENGTH,
    SIDE_GAP,
    SPEED,
    HandoverCase,
    HandoverRun,
    drive,
)
from omniman_ros.lab.studies.tool_courses import COURSES
from omniman_ros.lab.studies.tool_path import rms
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.sweep import Sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import robot_parameters

POSITION_BOUND = 0.02  #: bound of the true distance from the station [m]
HEADING_BOUND = math.radians(1.0)  #: bound of the true heading error [rad]
LEAST_SPEED = 0.95 * SPEED  #: speed of the leader below which it does not count as in motion [m/s]


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce handover`.

    Returns:
        1 if the aim is missed in a drive that has one, else 0.
    """
    robot, selected = robot_parameters(args.robot), cases(args.quick, args.seed)
    experiment = Experiment(
        args, f"Robots side by side at {SPEED:g} m/s, {SIDE_GAP:g} m apart: {len(selected)} drives"
    )
    calibration = calibrate(robot, WorldChoice.of(robot, args.world)) if args.world else {}
    robot = {**robot, **calibration}
    driven = Sweep.here().map(partial(drive, robot, args.world), selected)
    runs = experiment.collect(driven, len(selected))
    rows = [drive_row(each) for each in runs]
    passed = all(row["kept"] for row in rows if row["is_aim"])
    position, heading = 1e3 * POSITION_BOUND, math.degrees(HEADING_BOUND)
    body = build(Platform, robot)
    result = {
        "speed_m_s": SPEED,
        "length_m": LENGTH,
        "side_gap_m": SIDE_GAP,
        "kept_s": KEPT_TIME,
        "calibration": calibration,
        "bounds": {"position_mm": position, "heading_deg": heading},
        "drives": rows,
        "passed": passed,
        "picture": experiment.picture(
            lambda f, path: f.draw_handover(body, runs, POSITION_BOUND, HEADING_BOUND, path)
        ),
    }
    experiment.publish(result, report)
    return 0 if passed else 1


def cases(quick: bool, seed: int) -> list[HandoverCase]:
    """Return the drives, those with an aim first."""
    if quick:
        return [HandoverCase("S", "PI", seed)]
    return [HandoverCase(course, wheels, seed) for wheels in HANDOVER_WHEELS for course in COURSES]


def drive_row(run: HandoverRun) -> dict[str, Any]:
    """Return the figures of a drive for the JSON, with the units in their names.

    The station is `kept` if the true errors keep their bounds over the judged time, in which the
    leader is in motion, and the robots do not touch.
    """
    errors, gaps, speeds = run.errors()[run.kept], run.gaps(), run.speeds()
    distance, heading = np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])
    leader, follower = speeds[run.kept].T
    kept = (
        len(errors) > KEPT_TIME / (run.times[1] - run.times[0])
        and distance.max() <= POSITION_BOUND
        and heading.max() <= HEADING_BOUND
        and leader.min() >= LEAST_SPEED
        and gaps.min() > 0.0
    )
    return {
        "follower": "station_keeper",
        "course": run.case.course,
        "wheels": HANDOVER_WHEELS[run.case.wheels].about,
        "is_aim": run.case.is_aim,
        "max_mm": 1e3 * float(distance.max()),
        "rms_mm": 1e3 * rms(distance),
        "heading_max_deg": math.degrees(heading.max()),
        "heading_rms_deg": math.degrees(rms(heading)),
        "judged_from_s": run.kept_from,
        "least_gap_m": float(gaps.min()),
        "leader_m_s": float(leader.mean()),
        "follower_m_s": float(follower.mean()),
        "peak_m_s": float(speeds[:, 1].max()),
        "leader_j": float(run.energies[-1, 0]),
        "follower_j": float(run.energies[-1, 1]),
        "kept": bool(kept),
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    bounds = result["bounds"]
    return [
        "",
        f"Station kept for {result['kept_s']:g} s beside a leader at {result['speed_m_s']:g} m/s, "
        "by the ground truth:",
        *columns(
            result["drives"],
            ("follower, leader's path", "{follower}, {course}"),
            ("wheels", "{wheels}"),
            ("true error RMS", "{rms_mm:.1f}"),
            ("max", "{max_mm:.1f} mm"),
            ("heading max", "{heading_max_deg:.2f} deg"),
            ("judged from", "{judged_from_s:.1f} s"),
            ("least gap", "{least_gap_m:.2f} m"),
            ("follower's speed", "{follower_m_s:.2f} m/s"),
            ("energy", "{follower_j:.0f} J"),
            ("aim", lambda row: verdict(row["kept"], "kept") if row["is_aim"] else ""),
        ),
        "",
        f"Within {bounds['position_mm']:g} mm and {bounds['heading_deg']:g} degree: "
        f"{verdict(result['passed'], 'kept')}",
    ]
