"""`omniman reproduce handover`: two robots meet in motion, drive side by side, and part again.

MPC 2021, 5, proposes it: a load could be transferred between two robots that move in parallel. In
the physics world, the odometry of both is calibrated first, as neither sees what rollers take.
"""

import argparse
import math
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
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.reproduce.pipeline import collect, publish, result_name
from omniman_ros.lab.studies.handover import (
    HANDOVER_WHEELS,
    KEPT_TIME,
    SIDE_GAP,
    SPEED,
    UNCALIBRATED,
    Case,
    Run,
)
from omniman_ros.lab.studies.handover_drives import LENGTH, drive
from omniman_ros.lab.studies.odometry_calibration import calibrate
from omniman_ros.lab.studies.tool_courses import COURSES
from omniman_ros.lab.studies.tool_path import rms
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

POSITION_BOUND = 0.02  # bound of the true distance from the station [m]
HEADING_BOUND = math.radians(1.0)  # bound of the true heading error [rad]
LEAST_SPEED = 0.95 * SPEED  # speed of the leader below which it does not count as in motion [m/s]


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce handover`.

    Returns:
        1 if the aim is missed in a drive that has one, else 0.
    """
    robot = load_robot(args.robot)
    selected = cases(args.quick, args.seed)
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"Two robots '{args.robot}' side by side at {SPEED:g} m/s, {SIDE_GAP:g} m apart: "
        f"{len(selected)} drives"
        + (f", in the physics world on wheels '{args.world}'" if args.world else "")
    )
    calibration = calibrate(robot, WorldChoice.of(robot, args.world)) if args.world else {}
    robot = {**robot, **calibration}
    with ProcessPoolExecutor(min(len(selected), os.cpu_count() or 1)) as pool:
        generator = pool.map(partial(drive, dict(robot), args.world), selected)
        runs = collect(progress, "drives", generator, len(selected), "drives")
    rows = [drive_row(driven) for driven in runs]
    result: dict[str, Any] = {
        "robot": args.robot,
        "world": args.world,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "speed_m_s": SPEED,
        "length_m": LENGTH,
        "side_gap_m": SIDE_GAP,
        "kept_s": KEPT_TIME,
        "calibration": calibration,
        "bounds": {
            "position_mm": 1e3 * POSITION_BOUND,
            "heading_deg": math.degrees(HEADING_BOUND),
        },
        "drives": rows,
        "passed": all(row["kept"] for row in rows if row["is_aim"]),
    }
    name = result_name("handover", args.world)
    picture = draw(build(Robot, robot), runs, Path(args.results) / f"{name}.png")
    result["picture"] = picture and str(picture)
    publish(name, result, report, started, args.results)
    return 0 if result["passed"] else 1


def cases(quick: bool, seed: int) -> list[Case]:
    """Return the drives, those with an aim first."""
    if quick:
        return [Case("station_keeper", "S", "PI", seed)]
    aims = [wheels for wheels in HANDOVER_WHEELS if wheels != UNCALIBRATED]
    return [
        *(Case("station_keeper", course, wheels, seed) for wheels in aims for course in COURSES),
        *(Case("station_keeper", course, UNCALIBRATED, seed) for course in COURSES),
        *(Case("mpc_planner", course, aims[0], seed) for course in ("straight", "S")),
    ]


def drive_row(run: Run) -> dict[str, Any]:
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
        "follower": run.case.follower,
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


def draw(robot: Robot, runs: Sequence[Run], path: Path) -> Path | None:
    """Draw the drives as a PNG file; return its path, or None if matplotlib is not installed."""
    try:
        from omniman_ros.lab.figures import handover as handover_picture
    except ImportError:
        return None
    handover_picture.draw(robot, runs, POSITION_BOUND, HEADING_BOUND, path)
    return path


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    rows: list[tuple[str, ...]] = [
        (
            "follower, leader's path",
            "wheels",
            "true error RMS",
            "max",
            "heading max",
            "judged from",
            "least gap",
            "follower's speed",
            "energy",
            "aim",
        )
    ]
    rows += [
        (
            f"{row['follower']}, {row['course']}",
            row["wheels"],
            f"{row['rms_mm']:.1f}",
            f"{row['max_mm']:.1f} mm",
            f"{row['heading_max_deg']:.2f} deg",
            f"{row['judged_from_s']:.1f} s",
            f"{row['least_gap_m']:.2f} m",
            f"{row['follower_m_s']:.2f} m/s",
            f"{row['follower_j']:.0f} J",
            verdict(row["kept"], "kept") if row["is_aim"] else "",
        )
        for row in result["drives"]
    ]
    bounds = result["bounds"]
    lines = [
        "",
        f"Station kept for {result['kept_s']:g} s beside a leader at {result['speed_m_s']:g} m/s, "
        "by the ground truth:",
        *table(rows),
        "",
        f"Within {bounds['position_mm']:g} mm and {bounds['heading_deg']:g} degree: "
        f"{verdict(result['passed'], 'kept')}",
    ]
    if result["picture"]:
        lines.append(f"Picture: {result['picture']}")
    return lines
