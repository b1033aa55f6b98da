"""`omniman bench whole_body_obstacles`: the body dodges while the tool stays on its path.

Platform, drives, odometry and the arm's servo run in the physics world, in simulated time, and
obstacles are observed with noise; see `BodyLoop`. Distances are those of the true robot from where
everything truly is. The tool's error is that of the true joints and the odometry, against where
the tool is to be at that time. CPU times are of this process.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.extras import WORLD
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_least,
    at_most,
    conclude,
    cycle_figures,
)
from omniman_ros.lab.reproduce.pipeline import draw_picture
from omniman_ros.lab.studies.avoidance_scenes import (
    CROWD,
    KINDS,
    LATE,
    START,
    AvoidanceScene,
    SceneGenerator,
)
from omniman_ros.lab.studies.body_drivers import AvoidingBody, FixedPosture, ReactiveDriver
from omniman_ros.lab.studies.body_judge import JudgedBody, judged
from omniman_ros.lab.studies.body_loop import BodyDriver, BodyLoop
from omniman_ros.lab.sweep import Sweep
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters

SCENES = 25  #: Number of scenes of each kind
WHEELS = "rollers"  #: Wheels of the robot in the physics world
SPAN, SPARE = 2.5, 10.0  #: Longest duration: times the unhindered one, and added to it [s]
PROMISED, DEMANDING = "scenes that can be done", "crowds, and posts seen late"
GROUPS = {PROMISED: tuple(KINDS), DEMANDING: (CROWD, LATE)}
AVOIDS = "the body avoids"
METHODS = (AVOIDS, "reactive (NEO)", "fixed posture that waits", "fixed posture")
COMPLETED_AIM = {PROMISED: 0.97, DEMANDING: 0.9}  #: Aims: least fractions of scenes
FAST_AIM, FAST_RATIO = 0.9, 1.3  #: Aim: least fraction of scenes up to a time, over the unhindered
RMS_AIM, OFF_AIM = 1.0, 3.0  #: Aims: largest root mean square and error of the tool [mm]
CPU_AIM = {"median": 10.0, "p99": 20.0, "max": 50.0}  #: Aims: largest CPU times of a cycle [ms]
SEARCH_AIM = 1.0  #: Aim: largest CPU time of a search for a way [s]


SceneFigures = dict[str, dict[str, Any]]  #: Figures of a scene by method


def drive_scene(robot: str, kind: str, seed: int) -> SceneFigures:
    """Return the figures of a scene by method; empty where the seed has no scene."""
    generator = SceneGenerator(robot)
    scene = generator.scene(kind, seed)
    if scene is None:
        return {}
    values = dict(robot_parameters(resolve_robot(robot)))
    unhindered, dodge = scene.fixed.duration, generator.setup.dodge
    least = scene.least_time(
        generator.setup.path.linear_velocity, dodge.moving_clearance, dodge.time_gap
    )
    found = {}
    for method, make in _drivers(generator, scene).items():
        loop = BodyLoop(values, WHEELS, scene, START[3:], seed)
        driver = make()
        record = loop.run(driver, SPAN * unhindered + SPARE)
        figures = {"kind": kind, "seed": seed, "least_ratio": least / unhindered}
        figures |= figures_of(judged(generator, scene, record), unhindered)
        if isinstance(driver, AvoidingBody):
            figures["cycle_times"] = [
                sum(pair) for pair in zip(driver.cycle_times, driver.preview_times, strict=True)
            ]
            figures["search_s"] = max(driver.search_times)
        found[method] = figures
    return found


def drive_scenes(robot: str, kind: str, count: int, sweep: Sweep) -> list[SceneFigures]:
    """Return the figures of the first scenes of a kind by method; a few seeds have no scene."""
    found = list[SceneFigures]()
    first = 0
    while (missing := count - len(found)) > 0:
        seeds = range(first, first + missing)
        found += filter(None, sweep.collect(partial(drive_scene, robot, kind), seeds))
        first += missing
    return found


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


def figures_of(drive: JudgedBody, unhindered: float) -> dict[str, Any]:
    """Return the figures of a drive whose path takes a time with nothing around [s]."""
    done = drive.completed_at
    return {
        "completed": done is not None,
        "stop": drive.stop,
        "time_ratio": None if done is None else done / unhindered,
        "least_gap_mm": 1e3 * drive.least_gap,
        "contact": bool(drive.contacts()),
        "contact_at_rest": bool(drive.contacts(at_rest=True)),
        "tool_rms_mm": 1e3 * drive.rms,
        "tool_max_mm": 1e3 * float(drive.off.max()),
    }


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
        "time_ratios": sorted(row["time_ratio"] for row in clear),
        "time_ratio": float(np.median([row["time_ratio"] for row in clear])) if clear else None,
        "could_be_fast": sum(row["least_ratio"] <= FAST_RATIO for row in rows),
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
    sweep, count = Sweep.of(args), 1 if args.quick else args.scenes or SCENES
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "groups": {}}
    result["conditions"] = {"scenes_of_a_kind": count, "wheels": WHEELS, **sweep.conditions}
    for group, kinds in GROUPS.items():
        drives = []
        for kind in kinds:
            say(f"{group}: {kind} ...")
            drives += drive_scenes(args.robot, kind, count, sweep)
        found = {method: summary([drive[method] for drive in drives]) for method in METHODS}
        result["groups"][group] = found
    result["picture"] = draw_picture(
        lambda f, path: f.draw_outcomes(result["groups"], {PROMISED: FAST_AIM}, path),
        Path(args.results, "bench_whole_body_obstacles.png"),
        "body_figures",
    )
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
        possible = f"possible in {each['could_be_fast']} of {scenes}"
        fast = f"{group}: up to {FAST_RATIO} of the unhindered time ({possible})"
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
