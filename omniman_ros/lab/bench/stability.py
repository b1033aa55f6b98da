"""`omniman bench stability`: the arm stretched in the physics world, its posture known or not.

Four cases, on ideal wheels. Tracking: an arm with its whole payload, in torque mode, where
nothing but the feed-forward knows the masses. Tipping: a narrower and higher platform that stops
from a motion to the side, on which the arm is stretched. Swing: the same, but the arm stretches in
motion, and is not yet there when the robot stops. Silence: that of tipping, but the controller
falls silent, and the drives stop by their own ramp, which knows no posture.
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
SWING_TIME = 1.5
"""Duration of the swing to the stretched arm [s]."""
SWING_STOP = 1.05
"""Time of the stop after the beginning of the swing [s]."""
YAW_AIM = 0.5
"""Aim: largest ratio of the yaw rate's error to that with a fixed mass [-]."""
WAY_AIM = 1.02
"""Aim: largest ratio of the way of the stop to that without the lowered limits [-]."""
SWING_WAY_AIM = 1.1
"""The same where the arm stretches in motion, so that the robot is faster than the limits yet."""
STOPS = {"tipping": WAY_AIM, "swing": SWING_WAY_AIM, "silence": None}
"""Cases that end in a stop, with the aims for its way; the drives' own ramp has none."""


def measure(robot: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """Drive all cases, without and with the posture.

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
    from omniman_ros.lab.studies.arm_posture import Swing, drive

    loaded = {**robot, **PAYLOAD}
    narrow = {**loaded, "wheels.y": [TRACK * y for y in robot["wheels.y"]], **HIGH}
    cases = {
        "tracking": ({**loaded, "drive.mode": "torque"}, TRACKING, seconds, None),
        "tipping": (narrow, TIPPING, 1.8 * seconds, None),
        "swing": (narrow, TIPPING, 1.8 * seconds, Swing(SWING_TIME, SWING_STOP)),
        "silence": (narrow, TIPPING, 1.8 * seconds, None),
    }
    return {
        name: {
            label: asdict(
                drive(
                    values,
                    twists,
                    each,
                    knows_posture=known,
                    swing=swing,
                    is_silent=name == "silence",
                )
            )
            for label, known in (("unknown", False), ("known", True))
        }
        for name, (values, twists, each, swing) in cases.items()
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench stability`; return 0, the exit code of a successful measurement.

    Raises:
        CommandError: The engine is not installed, or the measurement failed.
    """
    if not WORLD.is_available:
        raise CommandError(WORLD.hint)
    say("tracking, tipping, swing and silence, without and with the posture ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result |= measure(load_robot(resolve_robot(args.robot)), 0.5 if args.quick else 1.0)
    return conclude("stability", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    tracking = result["tracking"]
    met = {
        "yaw_error": tracking["known"]["yaw_error"] <= YAW_AIM * tracking["unknown"]["yaw_error"]
    }
    for case, way_aim in STOPS.items():
        unknown, known = result[case]["unknown"], result[case]["known"]
        met[f"{case}_lifted"] = known["lifted"] == 0.0
        if way_aim is not None:
            met[f"{case}_stop_way"] = known["stop_way"] <= way_aim * unknown["stop_way"]
    return met


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    met = {key: verdict(good) for key, good in result["aims"].items()}
    rows: Rows = [("", "posture unknown", "known", "aim", "")]
    entries: list[tuple[str, str, str, str, float, float | None]] = [
        ("tracking", "speed_error", "error of wheel speeds, RMS", "mrad/s", 1e3, None),
        ("tracking", "yaw_error", "error of the yaw rate, RMS", "mrad/s", 1e3, YAW_AIM),
    ]
    for case, way_aim in STOPS.items():
        entries += [
            (case, "share", "share of the accelerations", "", 1.0, None),
            (case, "speed", "speed before the stop", "m/s", 1.0, None),
            (case, "stop_way", "way of the stop", "m", 1.0, way_aim),
            (case, "lifted", "time with a wheel lifted", "ms", 1e3, 0.0),
            (case, "least_load", "smallest load of a wheel", "N", 1.0, None),
            (case, "tilt", "largest tilt", "mrad", 1e3, None),
        ]
    for case, key, label, unit, scale, ratio in entries:
        unknown, known = (scale * result[case][side][key] for side in ("unknown", "known"))
        values = (f"{unknown:.3g} {unit}".strip(), f"{known:.3g} {unit}".strip())
        aim = "" if ratio is None else f"<= {ratio:g} of unknown" if ratio else "0"
        name = key if case == "tracking" else f"{case}_{key}"
        rows.append((f"{case}: {label}", *values, aim, met.get(name, "")))
    return tables(rows)
