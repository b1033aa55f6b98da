"""`omniman reproduce scenes`: the planner's node drives through random scenes.

Each drive is judged by the ground truth; see `studies.scenes`. In the physics world, the engine's
contacts count as well, and the odometry is calibrated first: what it is off is not the planner's.
"""

import argparse
from collections.abc import Mapping
from functools import partial
from typing import Any

from omniman_ros.console.errors import CommandError
from omniman_ros.extras import PLANNING, TRACKING, WORLD
from omniman_ros.lab.reproduce.pipeline import Experiment, columns
from omniman_ros.lab.studies.calibration import calibrate
from omniman_ros.lab.studies.scene_generator import SceneError
from omniman_ros.lab.studies.scenes import AIM_REACHED, TIME_LIMIT, aims, groups, summary
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.sweep import Sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.world.parameters import IDEAL

SCANNER = "scanner"  #: value of `--sense`
COUNT, QUICK, FULL = 240, 8, 1000  #: numbers of scenes
AIMS = {
    "contacts": ("drives with a contact", "0"),
    "left_workspace": ("drives that left the workspace", "0"),
    "reached_share": ("goals reached", f">= {100 * AIM_REACHED:g} %"),
}


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce scenes`.

    Returns:
        0 if no aim was missed, else 1.
    """
    seeds = scene_seeds(args)
    sweep = Sweep.of(args)
    if args.solve_time is not None and not 0.0 <= args.solve_time <= 1.0:
        raise CommandError(f"--solve-time must be 0 to 1 s, got {args.solve_time:g}", code=2)
    if args.sense == SCANNER:
        args.world = args.world or IDEAL
    for extra in (PLANNING, TRACKING, WORLD) if args.sense == SCANNER else (PLANNING,):
        if not extra.is_available:
            raise CommandError(extra.hint)
    from omniman_ros.lab.reproduce.scene_runs import SceneRunSettings, drive_scene  # needs rclpy

    experiment = Experiment(
        args,
        f"{len(seeds)} random scenes, at most {TIME_LIMIT:g} s each, the planner's node with "
        f"noisy odometry, obstacles by {args.sense}",
    )
    robot = robot_parameters(args.robot)
    calibration = calibrate(robot, WorldChoice.of(robot, args.world)) if args.world else {}
    settings = SceneRunSettings(
        args.robot, args.seed, args.solve_time, args.world, calibration, args.sense == SCANNER
    )
    driven = sweep.map(partial(drive_scene, settings), seeds)
    try:
        outcomes = experiment.collect(
            driven, len(seeds), lambda so_far: f", {sum(o.failed for o in so_far)} failed"
        )
    except SceneError as error:
        experiment.progress.abandon()
        raise CommandError(str(error)) from error
    met = aims(summary(outcomes))
    result = {
        "sense": args.sense,
        "solve_time_s": args.solve_time,
        "limit_s": TIME_LIMIT,
        "groups": {name: summary(members) for name, members in groups(outcomes).items()},
        "aims": met,
        "passed": all(met.values()),
        "failed": [outcome.scene.seed for outcome in outcomes if outcome.failed],
        "drives": [outcome.figures() for outcome in outcomes],
        "calibration": calibration,
    }
    experiment.publish(result, report)
    return 0 if result["passed"] else 1


def scene_seeds(args: argparse.Namespace) -> range:
    """Return the seeds of the scenes: those of `--seeds`, or as many as the effort asks for."""
    if args.seeds is None:
        return range(QUICK if args.quick else FULL if args.full else COUNT)
    try:
        first, _, last = args.seeds.partition(":")
        seeds = range(int(first), int(last) if last else int(first) + 1)
    except ValueError:
        seeds = range(0)
    if not seeds or seeds[0] < 0:
        raise CommandError(
            f"--seeds must be A:B with B above A, or one seed, 0 or more, got '{args.seeds}'",
            code=2,
        )
    return seeds


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    whole = result["groups"]["all"]
    failed = [row for row in result["drives"] if row["seed"] in result["failed"]]
    return [
        "",
        *columns(
            [{"name": name, **group} for name, group in result["groups"].items()],
            ("", "{name}"),
            ("drives", "{drives}"),
            ("contacts", "{contacts}"),
            ("left area", "{left_workspace}"),
            ("reached", "{reached}"),
            ("time", "{time_median_s:.1f} s"),
            ("energy", "{energy_median_j:.0f} J"),
            ("least gap", lambda group: f"{1e3 * group['least_clearance_m']:.0f} mm"),
            ("answer median", "{answer_median_ms:.1f} ms"),
            ("p99", "{answer_p99_ms:.1f} ms"),
            ("max", "{answer_max_ms:.1f} ms"),
            ("late", "{late} of {cycles}"),
        ),
        "",
        *columns(
            [{"key": key, "label": label, "aim": aim} for key, (label, aim) in AIMS.items()],
            ("", "{label}"),
            ("value", lambda row: _value(whole[row["key"]])),
            ("aim", "{aim}"),
            ("", lambda row: verdict(result["aims"][row["key"]])),
        ),
        "",
        *(f"Failed: {_describe_failure(row)}" for row in failed),
    ]


def _value(value: float) -> str:
    return f"{100 * value:.1f} %" if isinstance(value, float) else str(value)


def _describe_failure(row: Mapping[str, Any]) -> str:
    """Describe a failed drive in one line."""
    parts = [f"seed {row['seed']}"]
    if row["collided"]:
        parts.append(f"touched obstacle {row['touched'] + 1} after {row['contact_s']:.2f} s")
    if row["outside_m"] > 0.0:
        parts.append(f"left the workspace by {1e3 * row['outside_m']:.0f} mm")
    if not row["reached"] and not row["collided"]:
        parts.append(f"{row['off_m']:.2f} m from the goal after {row['time_s']:.1f} s")
        parts.append(row["last"])
    return ", ".join(parts)
