"""`omniman reproduce odometry`: what odometry is off after the path of CCTA 2017, Fig. 7.

The odometry is calibrated first, by a way ahead, one sideways and a rotation in place. Then the
path is driven with random wheels, in each mode of the drives, with the lag of the rollers known to
coupling control and unknown.
"""

import argparse
import math
import os
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.lab.reproduce.pipeline import collect, in_parallel, publish, result_name
from omniman_ros.lab.studies.coupling import GROUPS
from omniman_ros.lab.studies.odometry_calibration import calibrate
from omniman_ros.lab.studies.odometry_drive import OdometryCase, OdometryErrors, drive_odometry
from omniman_ros.lab.studies.roller_lag import measure_roller_lag
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.robots import load_robot

MODES = ("P", "PI", "torque")
"""Groups of drives: the ways in which the drives hold a wheel's speed."""
AIM = 0.02  # aim: largest error of the position at the end [m]
SENSORS = {"wheels": "wheels alone", "imu": "wheels and imu"}
"""Kinds of odometry: names in the result and in the report."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce odometry`.

    Returns:
        0, whether or not the aims are met.
    """
    robot = load_robot(args.robot)
    world = WorldChoice.of(robot, args.world) if args.world else None
    started = time.monotonic()
    figure = Figure7(length=1.0) if args.quick else Figure7()
    modes = MODES[:1] if args.quick else MODES
    samples = 1 if args.quick else 5 if args.full else 2
    progress = Progress()
    where = f", in the physics world on wheels '{args.world}'" if args.world else ""
    progress.headline(
        f"Odometry after the path of CCTA 2017, Fig. 7, robot '{args.robot}'{where}: calibration, "
        f"then drives of {figure.duration:.0f} s"
    )
    calibration = calibrate(robot, world)
    lag = measure_roller_lag(robot, world) if world else 0.0
    selected = [
        OdometryCase(mode, sample, known, args.seed)
        for mode in modes
        for known in ((0.0, lag) if lag else (0.0,))
        for sample in range(samples)
    ]
    one = partial(drive_odometry, {**robot, **calibration}, world, figure)
    generator = in_parallel(one, selected, min(len(selected), os.cpu_count() or 1))
    driven = collect(progress, "drives", generator, len(selected), "drives")
    rows = [row(case, errors) for case, errors in zip(selected, driven, strict=True)]
    result = {
        "robot": args.robot,
        "world": args.world,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "calibration": calibration,
        "aim_mm": 1e3 * AIM,
        "drives": rows,
        "aims": {kind: all(r[kind]["end_mm"] <= 1e3 * AIM for r in rows) for kind in SENSORS},
        "picture": None,
    }
    publish(result_name("odometry", args.world), result, report, started, args.results)
    return 0


def row(case: OdometryCase, errors: OdometryErrors) -> dict[str, Any]:
    """Return the figures of a drive for the JSON, with the units in their names."""
    ends = {
        kind: {
            "end_mm": 1e3 * math.hypot(error[0], error[1]),
            "heading_mrad": 1e3 * float(error[2]),
        }
        for kind, error in (("wheels", errors.wheels), ("imu", errors.imu))
    }
    return {
        "group": case.group,
        "about": GROUPS[case.group].about,
        "roller_lag_s": case.roller_lag,
        "sample": case.sample,
        "largest_mm": 1e3 * errors.largest,
        **ends,
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    rows: list[tuple[str, ...]] = [
        ("drives, coupling control", "wheels", "end", "heading", "largest", "end, imu", "heading")
    ]
    rows += [
        (
            each["about"] + (", with lag" if each["roller_lag_s"] else ""),
            f"set {each['sample'] + 1}",
            f"{each['wheels']['end_mm']:.1f} mm",
            f"{each['wheels']['heading_mrad']:+.1f} mrad",
            f"{each['largest_mm']:.1f} mm",
            f"{each['imu']['end_mm']:.1f} mm",
            f"{each['imu']['heading_mrad']:+.1f} mrad",
        )
        for each in result["drives"]
    ]
    calibration = ", ".join(
        f"{name.removeprefix('odometry.')} {value:.4f}"
        for name, value in result["calibration"].items()
    )
    lines = ["", f"Calibration: {calibration}", *table(rows), ""]
    for kind, about in SENSORS.items():
        ends = [each[kind]["end_mm"] for each in result["drives"]]
        lines.append(
            f"Odometry by {about}: {min(ends):.0f} to {max(ends):.0f} mm at the end, "
            f"aim at most {result['aim_mm']:g} mm: {verdict(result['aims'][kind])}"
        )
    return lines
