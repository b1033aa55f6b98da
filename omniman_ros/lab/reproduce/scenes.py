"""`omniman reproduce scenes`: the planner's node drives through random scenes.

Each drive is judged by the ground truth; see `studies.scenes`. In the physics world, the engine's
contacts count as well, and the odometry is calibrated first: what it is off is not the planner's.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.description.urdf import carries_arm
from omniman_ros.extras import PLANNING
from omniman_ros.lab.measurement import SINGLE_THREADED
from omniman_ros.lab.reproduce.pipeline import publish, result_name
from omniman_ros.lab.studies.odometry_calibration import calibrate
from omniman_ros.lab.studies.scene_generator import SceneError
from omniman_ros.lab.studies.scenes import AIM_REACHED, TIME_LIMIT, Outcome, aims, groups, summary
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

if TYPE_CHECKING:  # it needs rclpy
    from omniman_ros.lab.reproduce.scene_runs import SceneRunSettings

COUNT, QUICK, FULL = 240, 8, 1000  # numbers of scenes
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
    jobs = os.cpu_count() or 1 if args.jobs is None else args.jobs
    if jobs < 1:
        raise CommandError(f"--jobs must be 1 or more, got {jobs}", code=2)
    if args.solve_time is not None and not 0.0 <= args.solve_time <= 1.0:
        raise CommandError(f"--solve-time must be 0 to 1 s, got {args.solve_time:g}", code=2)
    if not PLANNING.is_available:
        raise CommandError(PLANNING.hint)
    robot = load_robot(args.robot)
    if args.arm and args.world:
        raise CommandError("--arm and --world exclude each other", code=2)
    if args.arm and not carries_arm(build(Robot, robot)):
        raise CommandError(f"the robot '{args.robot}' has no arm", code=2)
    name = "reproduce_arm_scenes" if args.arm else result_name("scenes", args.world)
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"{len(seeds)} random scenes, at most {TIME_LIMIT:g} s each, robot '{args.robot}', "
        "the planner's node with noisy odometry and noisy obstacle positions"
        + (f", in the physics world on wheels '{args.world}'" if args.world else "")
    )
    settings = _settings(args, robot)
    progress.begin("drives")
    outcomes: list[Outcome] = []
    try:
        for outcome in drive_scenes(settings, seeds, jobs):
            outcomes.append(outcome)
            failed = sum(each.failed for each in outcomes)
            text = f"{len(outcomes)} of {len(seeds)}, {failed} failed"
            progress.update(len(outcomes) / len(seeds), text)
    except SceneError as error:
        progress.abandon()
        raise CommandError(str(error)) from error
    progress.end(text)
    result = figures(args, outcomes) | {"calibration": dict(settings.calibration)}
    publish(name, result, report, started, args.results)
    return 0 if result["passed"] else 1


def _settings(args: argparse.Namespace, robot: Mapping[str, Any]) -> "SceneRunSettings":
    """Return the settings of the drives; in a world, the robot drives first to be calibrated."""
    from omniman_ros.lab.reproduce.scene_runs import SceneRunSettings

    world = WorldChoice.of(robot, args.world) if args.world else None
    calibration = calibrate(robot, world) if world else {}
    return SceneRunSettings(
        args.robot, args.seed, args.solve_time, args.arm, args.world, calibration
    )


def scene_seeds(args: argparse.Namespace) -> range:
    """Return the seeds of the scenes: those of `--seeds`, or the first `--count` from 0 on."""
    if args.seeds is None:
        default = QUICK if args.quick else FULL if args.full else COUNT
        count: int = default if args.count is None else args.count
        if count < 1:
            raise CommandError(f"--count must be 1 or more, got {count}", code=2)
        return range(count)
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


def drive_scenes(
    settings: "SceneRunSettings", seeds: Sequence[int], jobs: int
) -> Iterator[Outcome]:
    """Yield the judged outcomes of the scenes of seeds, in their order, from several processes."""
    from omniman_ros.lab.reproduce.scene_runs import make_driver

    drive = make_driver(settings)
    if jobs == 1:
        yield from map(drive, seeds)
        return
    os.environ.update(SINGLE_THREADED)  # numerical libraries read these when they are loaded
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(seeds)), mp_context=spawn) as pool:
        yield from pool.map(drive, seeds)


def figures(args: argparse.Namespace, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the result for the JSON: statistics by group of scenes, aims, and every drive."""
    met = aims(summary(outcomes))
    return {
        "robot": args.robot,
        "arm": args.arm,
        "world": args.world,
        "seed": args.seed,
        "solve_time_s": args.solve_time,
        "limit_s": TIME_LIMIT,
        "groups": {name: summary(members) for name, members in groups(outcomes).items()},
        "aims": met,
        "passed": all(met.values()),
        "failed": [outcome.scene.seed for outcome in outcomes if outcome.failed],
        "drives": [outcome.figures() for outcome in outcomes],
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    header = ("", "drives", "contacts", "left area", "reached", "time", "energy", "least gap")
    rows: list[tuple[str, ...]] = [(*header, "answer median", "p99", "max", "late")]
    rows += [_cells(name, group) for name, group in result["groups"].items()]
    lines = ["", *table(rows)]
    rows = [("", "value", "aim", "")]
    for key, (label, aim) in AIMS.items():
        value = result["groups"]["all"][key]
        shown = f"{100 * value:.1f} %" if isinstance(value, float) else str(value)
        rows.append((label, shown, aim, verdict(result["aims"][key])))
    lines += ["", *table(rows)]
    failed = [row for row in result["drives"] if row["seed"] in result["failed"]]
    lines += [f"Failed: {_describe_failure(row)}" for row in failed]
    return lines


def _cells(name: str, group: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        name,
        str(group["drives"]),
        str(group["contacts"]),
        str(group["left_workspace"]),
        str(group["reached"]),
        f"{group['time_median_s']:.1f} s",
        f"{group['energy_median_j']:.0f} J",
        f"{1e3 * group['least_clearance_m']:.0f} mm",
        f"{group['answer_median_ms']:.1f} ms",
        f"{group['answer_p99_ms']:.1f} ms",
        f"{group['answer_max_ms']:.1f} ms",
        f"{group['late']} of {group['cycles']}",
    )


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
