"""`omniman reproduce dodge`: the body dodges while the tool stays on its path (CCTA 2017, V.A).

The tool goes straight ahead past posts and over a table while two persons cross, in the physics
world and in simulated time; see `BodyLoop`. The same scene is driven with the arm's configuration
kept, with and without waiting for what is in the way.
"""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.extras import WORLD
from omniman_ros.lab.reproduce.pipeline import Experiment, columns
from omniman_ros.lab.studies.avoidance_scenes import (
    PERSON,
    POST,
    START,
    TABLE,
    AvoidanceScene,
    SceneGenerator,
)
from omniman_ros.lab.studies.body_drivers import AvoidingBody, FixedPosture
from omniman_ros.lab.studies.body_judge import JudgedBody, judged
from omniman_ros.lab.studies.body_loop import BodyDriver, BodyLoop
from omniman_ros.lab.sweep import Sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters

WHEELS = "rollers"  #: Wheels of the robot in the physics world
LENGTH, QUICK_LENGTH = 5.0, 2.0  #: Length of the tool's path [m]
SPACING = 0.05  #: Distance between two poses of the path [m]
SPAN = 2.0  #: Longest duration, over that of the path with nothing around
AHEAD = 0.8  #: Distance ahead of base_link within which something counts, at the end [m]
#: What stands beside and below the path: its shape, and its place in odom [m]
STANDING = ((POST, (1.8, -0.4)), (POST, (3.3, 0.7)), (TABLE, (4.3, 0.2)))
#: Who crosses: where [m], when [s], and the velocity [m/s]
CROSSING = (((1.6, 0.2), 5.0, (0.2, -0.7)), ((5.6, 0.3), 26.0, (-0.3, 0.7)))
AVOIDS, WAITS, KEEPS = "the body avoids", "fixed posture that waits", "fixed posture"
RMS_AIM, MAX_AIM = 0.001, 0.003  #: Aims: bounds of the tool's error [m]


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce dodge`.

    Returns:
        1 if the body that avoids touches something while it moves, does not complete its path, or
        the tool exceeds a bound, else 0.
    """
    if not WORLD.is_available:
        raise CommandError(WORLD.hint)
    args.world, robot = WHEELS, resolve_robot(args.robot)
    length = QUICK_LENGTH if args.quick else LENGTH
    methods = [AVOIDS] if args.quick else [AVOIDS, WAITS, KEEPS]
    experiment = Experiment(args, f"tool0 along {length:g} m past what stands and who walks")
    driven = Sweep.here().map(partial(drive, robot, length, args.seed), methods)
    drives = dict(zip(methods, experiment.collect(driven, len(methods)), strict=True))
    rows = [drive_row(name, each) for name, each in drives.items()]
    generator = SceneGenerator(robot)
    scene = scene_of(generator, length)
    passed = rows[0]["kept"]
    result = {
        "length_m": length,
        "unhindered_s": scene.fixed.duration,
        "bounds": {"rms_mm": 1e3 * RMS_AIM, "max_mm": 1e3 * MAX_AIM},
        "drives": rows,
        "passed": passed,
        "picture": experiment.picture(
            lambda f, path: f.draw_dodge(generator, scene, drives, (RMS_AIM, MAX_AIM), path),
            "body_figures",
        ),
    }
    experiment.publish(result, report)
    return 0 if passed else 1


def scene_of(generator: SceneGenerator, length: float) -> AvoidanceScene:
    """Return the scene along a path of a length [m]: what is met before the path's end."""
    along = np.linspace(0.0, length, round(length / SPACING) + 1)[1:]
    poses = np.repeat(generator.model.forward(START)[None], len(along), axis=0)
    poses[:, 0, 3] += along
    met = [(thing, place, 0.0, (0.0, 0.0)) for thing, place in STANDING]
    met += [(PERSON, *crossing) for crossing in CROSSING]
    met = [each for each in met if each[1][0] < length + AHEAD]
    things, places, times, velocities = zip(*met, strict=True)
    starts = np.array(places) - np.array(times)[:, None] * np.array(velocities)
    fixed = generator.planner.plan(poses, START).curve
    return AvoidanceScene(poses, fixed, things, starts, np.array(velocities))


def drive(robot: str, length: float, seed: int, method: str) -> JudgedBody:
    """Drive the scene by a method."""
    generator = SceneGenerator(robot)
    scene, setup = scene_of(generator, length), generator.setup
    drivers: dict[str, Callable[[], BodyDriver]] = {
        AVOIDS: lambda: AvoidingBody(setup, scene.poses),
        WAITS: lambda: FixedPosture(setup, scene.poses, scene.things),
        KEEPS: lambda: FixedPosture(setup, scene.poses),
    }
    values = dict(robot_parameters(robot))
    loop = BodyLoop(values, WHEELS, scene, START[3:], seed)
    return judged(generator, scene, loop.run(drivers[method](), SPAN * scene.fixed.duration))


def drive_row(method: str, drive: JudgedBody) -> dict[str, Any]:
    """Return the figures of a drive for the JSON, with the units in their names.

    A drive is `kept` if its path is completed, nothing touches the robot while it moves, and the
    tool's error keeps both bounds.
    """
    done, contacts, largest = drive.completed_at, drive.contacts(), float(drive.off.max())
    return {
        "method": method,
        "completed_s": done,
        "stop": drive.stop,
        "tool_m": float(np.linalg.norm(drive.tool[-1] - drive.tool[0])),
        "contact_s": min(contacts, default=None),
        "contact_at_rest_s": min(drive.contacts(at_rest=True), default=None),
        "least_gap_mm": 1e3 * drive.least_gap,
        "rms_mm": 1e3 * drive.rms,
        "max_mm": 1e3 * largest,
        "kept": done is not None and not contacts and drive.rms <= RMS_AIM and largest <= MAX_AIM,
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    row, bounds = result["drives"][0], result["bounds"]
    contact = verdict(row["contact_s"] is None, "none")
    rms = verdict(row["rms_mm"] <= bounds["rms_mm"], "kept")
    largest = verdict(row["max_mm"] <= bounds["max_mm"], "kept")
    return [
        "",
        "By the ground truth; the tool's error is that from where it is to be, in odom:",
        *columns(
            result["drives"],
            ("motion", "{method}"),
            ("end reported", lambda row: _seconds(row["completed_s"])),
            ("tool moved", "{tool_m:.2f} m"),
            ("contact in motion", lambda row: _seconds(row["contact_s"])),
            ("at rest", lambda row: _seconds(row["contact_at_rest_s"])),
            ("least gap", "{least_gap_mm:.0f} mm"),
            ("tool RMS", "{rms_mm:.2f}"),
            ("max", "{max_mm:.2f} mm"),
        ),
        "",
        f"With nothing around, the path takes {result['unhindered_s']:.1f} s.",
        f"The body avoids: path {verdict(row['completed_s'] is not None, 'completed')}; "
        f"contact in motion: {contact}; tool within {bounds['rms_mm']:g} mm RMS: {rms}, "
        f"{bounds['max_mm']:g} mm: {largest}",
    ]


def _seconds(time: float | None) -> str:
    return "-" if time is None else f"{time:.1f} s"
