"""`omniman bench whole_body_obstacles`: the body dodges while the tool stays on its path.

Platform, drives, odometry and the arm's servo run in the physics world, in simulated time, and
obstacles are observed with noise; see `BodyLoop`. Distances are those of the true robot from where
everything truly is. The tool's error is that of the true joints and the odometry, against where
the tool is to be at that time. CPU times are of this process.
"""

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.extras import WORLD
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_least,
    at_most,
    conclude,
    cycle_figures,
    in_processes,
)
from omniman_ros.lab.studies.avoidance_scenes import (
    CROWD,
    KINDS,
    LATE,
    START,
    AvoidanceScene,
    SceneGenerator,
)
from omniman_ros.lab.studies.body_drivers import AvoidingBody, FixedPosture, ReactiveDriver
from omniman_ros.lab.studies.body_loop import BodyDriver, BodyLoop, BodyRecord
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.world.distances import ConfigurationDistances

SCENES = 25  #: Number of scenes of each kind
WHEELS = "rollers"  #: Wheels of the robot in the physics world
SPAN, SPARE = 2.5, 10.0  #: Longest duration: times the unhindered one, and added to it [s]
STEP = 0.025  #: Time between two looks at the distances [s]
REACH = 1.0  #: Largest distance that is measured [m]
#: Speed of platform [m/s, with half of rad/s] or joints [rad/s] from which on a robot moves
MOVING = 0.02
PROMISED, DEMANDING = "scenes that can be done", "crowds, and posts seen late"
GROUPS = {PROMISED: tuple(KINDS), DEMANDING: (CROWD, LATE)}
AVOIDS = "the body avoids"
METHODS = (AVOIDS, "reactive (NEO)", "fixed posture that waits", "fixed posture")
COMPLETED_AIM = {PROMISED: 0.97, DEMANDING: 0.9}  #: Aims: least fractions of scenes
FAST_AIM, FAST_RATIO = 0.9, 1.3  #: Aim: least fraction of scenes up to a time, over the unhindered
RMS_AIM, OFF_AIM = 1.0, 3.0  #: Aims: largest root mean square and error of the tool [mm]
CPU_AIM = {"median": 10.0, "p99": 20.0, "max": 50.0}  #: Aims: largest CPU times of a cycle [ms]
SEARCH_AIM = 1.0  #: Aim: largest CPU time of a search for a way [s]


def drive_scene(robot: str, kind: str, seed: int, method: str) -> dict[str, Any] | None:
    """Return the figures of a scene; None where the seed has no scene."""
    generator = SceneGenerator(robot)
    scene = generator.scene(kind, seed)
    if scene is None:
        return None
    values = dict(robot_parameters(resolve_robot(robot)))
    loop = BodyLoop(values, WHEELS, scene, START[3:], seed)
    driver = _drivers(generator, scene)[method]()
    record = loop.run(driver, SPAN * scene.fixed.duration + SPARE)
    figures = {"kind": kind, "seed": seed, "method": method, **judged(generator, scene, record)}
    if isinstance(driver, AvoidingBody):
        figures["cycle_times"] = [
            sum(pair) for pair in zip(driver.cycle_times, driver.preview_times, strict=True)
        ]
        figures["search_s"] = max(driver.search_times)
    return figures


def _drivers(
    generator: SceneGenerator, scene: AvoidanceScene
) -> dict[str, Callable[[], BodyDriver]]:
    setup, poses = generator.setup, scene.poses
    return {
        AVOIDS: lambda: AvoidingBody(setup, poses),
        METHODS[1]: lambda: ReactiveDriver(setup, poses),
        METHODS[2]: lambda: FixedPosture(setup, poses, scene.things),
        METHODS[3]: lambda: FixedPosture(setup, poses),
    }


def judged(generator: SceneGenerator, scene: AvoidanceScene, record: BodyRecord) -> dict[str, Any]:
    """Return the figures of a drive."""
    arm, platform = np.array(record.arm), np.array(record.platform)
    arm = arm[arm[:, 0] >= 0.0]
    odom = np.column_stack(_columns(platform[:, :4], arm[:, 0]))
    tool = generator.model.forward(np.hstack([odom, arm[:, 1:7]]))[:, :3, 3]
    off = 1e3 * np.linalg.norm(tool - arm[:, 7:], axis=1)
    least, moved, stood = _contacts(generator, scene, record, arm, platform)
    done = record.completed_at
    return {
        "completed": done is not None,
        "stop": record.stop,
        "time_ratio": None if done is None else done / scene.fixed.duration,
        "least_gap_mm": 1e3 * least,
        "contact": moved,
        "contact_at_rest": stood,
        "tool_rms_mm": float(np.sqrt((off**2).mean())),
        "tool_max_mm": float(off.max()),
    }


def _contacts(
    generator: SceneGenerator,
    scene: AvoidanceScene,
    record: BodyRecord,
    arm: Array,
    platform: Array,
) -> tuple[float, bool, bool]:
    """Return the least gap [m], and whether something touched a robot that moved, or rested."""
    distances = ConfigurationDistances(generator.setup.description, scene.things)
    times = np.arange(0.0, arm[-1, 0], STEP)
    true = np.column_stack([platform[:, 0], platform[:, 4:]])
    pose = np.column_stack(_columns(true, times))
    joints = np.column_stack(_columns(arm[:, :7], times))
    gaps = np.full(len(times), REACH)
    for k, now in enumerate(times.tolist() if scene.things else ()):
        distances.place(pose[k], joints[k], scene.places_at(now))
        gaps[k] = distances.distances(REACH).min()
    rates = np.abs(np.gradient(np.hstack([pose, joints]), STEP, axis=0))
    speed = np.maximum(np.hypot(rates[:, 0], rates[:, 1]) + 0.5 * rates[:, 2], rates[:, 3:].max(1))
    touches = gaps <= 0.0
    felt = [at for at, _ in record.contacts if 0.0 <= at < times[-1]]
    touches[np.searchsorted(times, felt)] = True
    begins = touches & ~np.concatenate([[False], touches[:-1]])
    moves = speed > MOVING
    return float(gaps.min()), bool((begins & moves).any()), bool((begins & ~moves).any())


def _columns(rows: Array, times: Array) -> list[Array]:
    """Return all columns after the time, each (n,) at times (n,), by linear interpolation."""
    return [np.interp(times, rows[:, 0], column) for column in rows[:, 1:].T]


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the figures of a method in several scenes."""
    clear = [row for row in rows if row["completed"] and not row["contact"]]
    safe = [row for row in rows if not row["contact"] and not row["stop"]]
    fast = sum(row["time_ratio"] <= FAST_RATIO for row in clear)
    result: dict[str, Any] = {
        "scenes": len(rows),
        "clear": len(clear),
        "safe": len(safe),
        "fast": fast,
        "contacts": sum(row["contact"] for row in rows),
        "contacts_at_rest": sum(row["contact_at_rest"] for row in rows),
        "least_gap_mm": min(row["least_gap_mm"] for row in rows),
        "time_ratio": float(np.median([row["time_ratio"] for row in clear])) if clear else None,
        "tool_rms_mm": max(row["tool_rms_mm"] for row in rows),
        "tool_max_mm": max(row["tool_max_mm"] for row in rows),
        "failed": [f"{row['kind']} {row['seed']}" for row in rows if row not in clear],
    }
    times = [row["cycle_times"] for row in rows if row.get("cycle_times")]
    result["cycle"] = cycle_figures(times) if times else None
    result["search_s"] = max((row["search_s"] for row in rows if "search_s" in row), default=None)
    return result


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body_obstacles`; return 0, the exit code of a measurement."""
    if not WORLD.is_available:
        raise CommandError(WORLD.hint)
    jobs, count = args.jobs or os.cpu_count() or 1, 1 if args.quick else args.scenes or SCENES
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "groups": {}}
    result["conditions"] = {"scenes_of_a_kind": count, "jobs": jobs, "wheels": WHEELS}
    for group, kinds in GROUPS.items():
        found: dict[str, Any] = {}
        for method in METHODS:
            say(f"{group}: {method} ...")
            tasks = [(args.robot, kind, seed, method) for kind in kinds for seed in range(count)]
            rows = [row for row in in_processes(drive_scene, tasks, jobs) if row is not None]
            found[method] = summary(rows)
        result["groups"][group] = found
    return conclude("whole_body_obstacles", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    titles = ("completed", "contacts", "at rest", "least gap", "time", "tool RMS, max")
    parts = []
    for group, methods in result["groups"].items():
        rows = [_row(f"{group}: {name}", each) for name, each in methods.items()]
        parts.append(BenchmarkTable(titles, rows))
    for group, methods in result["groups"].items():
        parts.append(BenchmarkTable(("value",), _aimed(group, methods[AVOIDS])))
    return parts


def _row(about: str, each: Mapping[str, Any]) -> Figure:
    ratio = each["time_ratio"]
    return Figure(
        about,
        (
            f"{each['clear']} of {each['scenes']}",
            f"{each['contacts']}",
            f"{each['contacts_at_rest']}",
            f"{each['least_gap_mm']:.0f} mm",
            "-" if ratio is None else f"{ratio:.2f}",
            f"{each['tool_rms_mm']:.2f}, {each['tool_max_mm']:.1f} mm",
        ),
    )


def _aimed(group: str, each: Mapping[str, Any]) -> list[Figure]:
    """Return the rows with aims of the body that avoids in a group of scenes."""
    scenes, least = each["scenes"], COMPLETED_AIM[group]
    done = "clear" if group == PROMISED else "safe"
    words = {"clear": "completed without contact", "safe": "completed, or waiting safely"}
    rows = [
        at_most(f"{group}: contacts of a robot that moves", each["contacts"], 0),
        at_least(f"{group}: {words[done]}", each[done] / scenes, least, "{:.0%}"),
    ]
    if group == PROMISED:
        fast = f"{group}: up to {FAST_RATIO} of the unhindered time"
        rows += [
            at_least(fast, each["fast"] / scenes, FAST_AIM, "{:.0%}"),
            at_most(f"{group}: tool, RMS", each["tool_rms_mm"], RMS_AIM, "{:.2f} mm"),
            at_most(f"{group}: tool, largest", each["tool_max_mm"], OFF_AIM, "{:.1f} mm"),
        ]
    for key, aim in CPU_AIM.items():
        value = each["cycle"] and each["cycle"][f"{key}_ms"]
        rows.append(at_most(f"{group}: CPU of a cycle, {key}", value, aim, "{:.1f} ms"))
    rows.append(at_most(f"{group}: CPU of a search", each["search_s"], SEARCH_AIM, "{:.2f} s"))
    return rows
