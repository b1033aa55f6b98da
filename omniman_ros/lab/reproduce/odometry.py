"""`omniman reproduce odometry`: what odometry is off after the path of CCTA 2017, Fig. 7.

The odometry is calibrated first, by a way ahead, one sideways and a rotation in place. Then the
path is driven with random wheels, in each mode of the drives, with the lag of the rollers known to
coupling control and unknown.
"""

import argparse
from collections.abc import Mapping
from functools import partial
from typing import Any

from omniman_ros.lab.reproduce.pipeline import Experiment, columns
from omniman_ros.lab.studies.calibration import calibrate, measure_roller_lag
from omniman_ros.lab.studies.odometry_drive import OdometryCase, drive_odometry
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.sweep import Sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.robots import robot_parameters

MODES = ("P", "PI", "torque")  #: groups of drives: how the drives hold a wheel's speed
AIM = 0.02  #: aim: largest error of the position at the end [m]
#: Kinds of odometry: names in the result and in the report
SENSORS = {"wheels": "wheels alone", "imu": "wheels and imu"}


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce odometry`; return 0, whether or not the aims are met."""
    robot = robot_parameters(args.robot)
    world = WorldChoice.of(robot, args.world) if args.world else None
    figure = Figure7(length=1.0) if args.quick else Figure7()
    experiment = Experiment(
        args,
        "Odometry after the path of CCTA 2017, Fig. 7: calibration, then drives of "
        f"{figure.duration:.0f} s",
    )
    calibration = calibrate(robot, world)
    lag = measure_roller_lag(robot, world) if world else 0.0
    selected = [
        OdometryCase(mode, sample, known, args.seed)
        for mode in (MODES[:1] if args.quick else MODES)
        for known in ((0.0, lag) if lag else (0.0,))
        for sample in range(1 if args.quick else 5 if args.full else 2)
    ]
    one = partial(drive_odometry, {**robot, **calibration}, world, figure)
    generator = Sweep.here().map(one, selected)
    rows = experiment.collect(generator, len(selected))
    result = {
        "full": args.full,
        "calibration": calibration,
        "aim_mm": 1e3 * AIM,
        "drives": rows,
        "aims": {kind: all(r[kind]["end_mm"] <= 1e3 * AIM for r in rows) for kind in SENSORS},
    }
    experiment.publish(result, report)
    return 0


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    calibration = ", ".join(
        f"{name.removeprefix('odometry.')} {value:.4f}"
        for name, value in result["calibration"].items()
    )
    lines = [
        "",
        f"Calibration: {calibration}",
        *columns(
            result["drives"],
            (
                "drives, coupling control",
                lambda row: row["about"] + (", with lag" if row["roller_lag_s"] else ""),
            ),
            ("wheels", lambda row: f"set {row['sample'] + 1}"),
            ("end", "{wheels[end_mm]:.1f} mm"),
            ("heading", "{wheels[heading_mrad]:+.1f} mrad"),
            ("largest", "{largest_mm:.1f} mm"),
            ("end, imu", "{imu[end_mm]:.1f} mm"),
            ("heading", "{imu[heading_mrad]:+.1f} mrad"),
        ),
        "",
    ]
    for kind, about in SENSORS.items():
        ends = [each[kind]["end_mm"] for each in result["drives"]]
        lines.append(
            f"Odometry by {about}: {min(ends):.0f} to {max(ends):.0f} mm at the end, "
            f"aim at most {result['aim_mm']:g} mm: {verdict(result['aims'][kind])}"
        )
    return lines
