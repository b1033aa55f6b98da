"""`omniman bench stability`: the arm stretched in the physics world, its posture known or not.

Two cases, on ideal wheels. Tracking: an arm with its whole payload, in torque mode, where nothing
but the feed-forward knows the masses. Tipping: a narrower and higher platform that stops from a
motion to the side, on which the arm is stretched.
"""

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.extras import WORLD
from omniman_ros.lab.bench.harness import Rows, conclude, tables
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import load_robot

PAYLOAD = {"arm.mass": 23.4}
"""Mass of a UR5 with the whole payload of its data sheet [kg]."""
TRACK = 0.74
"""Track of the narrow platform over that of the robot [-]."""
HIGH = {
    "body.com_z": 0.45,
    "mount.z": 0.8,
    "limits.linear_acceleration": 2.0,
    "limits.linear_deceleration": 3.0,
}
"""What is higher on the narrow platform [m], and limits that it does not bear [m/s^2]."""
TRACKING = ((0.0, 0.8, 0.0), (0.0, 0.0, 1.0), (0.5, 0.0, -0.8), (0.0, -0.8, 0.6), (-0.6, 0.0, 0.0))
"""Twists of the tracking case [m/s, m/s, rad/s]."""
TIPPING = ((0.0, 1.0, 0.0),)
"""Twist of the tipping case [m/s, m/s, rad/s]."""
YAW_AIM = 0.5
"""Aim: largest ratio of the yaw rate's error to that with a fixed mass [-]."""
WAY_AIM = 1.02
"""Aim: largest ratio of the way of the stop to that without the lowered limits [-]."""


def measure(robot: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """Drive both cases, without and with the posture.

    Args:
        robot: Parameters of a robot with an arm, full names to values.
        seconds: Duration of each twist [s].

    Returns:
        Figures of each case: `unknown` and `known`.

    Raises:
        CommandError: The controller stopped, or the robot has no arm.
    """
    if not robot.get("arm.mass", 0.0):
        raise CommandError("the robot has no arm")
    # The command line must do without the engine.
    from omniman_ros.lab.studies.arm_posture import drive

    narrow = {"wheels.y": [TRACK * y for y in robot["wheels.y"]], **HIGH}
    cases = {
        "tracking": ({**robot, **PAYLOAD, "drive.mode": "torque"}, TRACKING, seconds),
        "tipping": ({**robot, **PAYLOAD, **narrow}, TIPPING, 1.8 * seconds),
    }
    return {
        name: {
            label: asdict(drive(values, twists, each, knows_posture=known))
            for label, known in (("unknown", False), ("known", True))
        }
        for name, (values, twists, each) in cases.items()
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench stability`; return 0, the exit code of a successful measurement.

    Raises:
        CommandError: The engine is not installed, or the measurement failed.
    """
    if not WORLD.is_available:
        raise CommandError(WORLD.hint)
    say("tracking and tipping, without and with the posture ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result |= measure(load_robot(resolve_robot(args.robot)), 0.5 if args.quick else 1.0)
    return conclude("stability", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    tracking, tipping = result["tracking"], result["tipping"]
    return {
        "yaw_error": tracking["known"]["yaw_error"] <= YAW_AIM * tracking["unknown"]["yaw_error"],
        "no_wheel_lifted": tipping["known"]["lifted"] == 0.0,
        "stop_way": tipping["known"]["stop_way"] <= WAY_AIM * tipping["unknown"]["stop_way"],
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    met = {key: verdict(good) for key, good in result["aims"].items()}
    rows: Rows = [("", "posture unknown", "known", "aim", "")]
    for case, label, key, unit, scale, aim, name in (
        ("tracking", "error of wheel speeds, RMS", "speed_error", "mrad/s", 1e3, "", ""),
        (
            "tracking",
            "error of the yaw rate, RMS",
            "yaw_error",
            "mrad/s",
            1e3,
            f"<= {YAW_AIM:g} of unknown",
            "yaw_error",
        ),
        ("tipping", "share of the accelerations", "share", "", 1.0, "", ""),
        ("tipping", "speed before the stop", "speed", "m/s", 1.0, "", ""),
        (
            "tipping",
            "way of the stop",
            "stop_way",
            "m",
            1.0,
            f"<= {WAY_AIM:g} of unknown",
            "stop_way",
        ),
        ("tipping", "time with a wheel lifted", "lifted", "ms", 1e3, "0", "no_wheel_lifted"),
        ("tipping", "smallest load of a wheel", "least_load", "N", 1.0, "", ""),
        ("tipping", "largest tilt", "tilt", "mrad", 1e3, "", ""),
    ):
        unknown, known = (scale * result[case][side][key] for side in ("unknown", "known"))
        values = (f"{unknown:.3g} {unit}".strip(), f"{known:.3g} {unit}".strip())
        rows.append((f"{case}: {label}", *values, aim, met.get(name, "")))
    return tables(rows)
