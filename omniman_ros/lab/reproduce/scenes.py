"""`omniman reproduce scenes`: the planner's node through random scenes, judged from the truth."""

import argparse
import multiprocessing
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.extras import PLANNING
from omniman_ros.lab.bench.measurement import SINGLE_THREADED
from omniman_ros.lab.reproduce.pipeline import publish
from omniman_ros.lab.studies.scene_generator import SceneError
from omniman_ros.lab.studies.scenes import AIM_REACHED, LIMIT, Outcome, aims, groups, summary
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

if TYPE_CHECKING:
    from omniman_ros.lab.reproduce.scene_runs import Request

NAME = "reproduce_scenes"
COUNT = 240
"""Default number of scenes."""
QUICK = 8
"""Number of scenes of a quick run."""
FULL = 1000
"""Number of scenes of a full run."""
SHOWN = 9
"""Most scenes in the picture."""
AIMS = (
    ("collisions that the robot could have avoided", "own_collisions", "0", "own_collisions"),
    ("drives that left the workspace", "left_workspace", "0", "left_workspace"),
    (
        "goals reached, of those there is a way to",
        "reached_of_solvable",
        f">= {100 * AIM_REACHED:g} %",
        "reached",
    ),
)
"""Rows of the aims: label, name of the figure, text of the aim, and name of the aim."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce scenes`; return 0 if the aims were met, else 1."""
    seeds = seeds_of(args)
    jobs = os.cpu_count() or 1 if args.jobs is None else args.jobs
    if jobs < 1:
        raise CommandError(f"--jobs must be 1 or more, got {jobs}", code=2)
    if args.solve_time is not None and not 0.0 <= args.solve_time <= 1.0:
        raise CommandError(f"--solve-time must be 0 to 1 s, got {args.solve_time:g}", code=2)
    if not PLANNING.is_available:
        raise CommandError(PLANNING.hint)
    robot = load_robot(args.robot)
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"{len(seeds)} random scenes, at most {LIMIT:g} s each, robot '{args.robot}', "
        "the planner's node on noisy odometry and obstacles"
    )
    progress.begin("drives")
    outcomes: list[Outcome] = []
    failed = 0
    try:
        for outcome in driven(_request(args), seeds, jobs):
            outcomes.append(outcome)
            failed += outcome.failed
            progress.update(
                len(outcomes) / len(seeds), f"{len(outcomes)} of {len(seeds)}, {failed} failed"
            )
    except SceneError as error:
        progress.abandon()
        raise CommandError(str(error)) from error
    progress.end(f"{len(outcomes)} drives, {failed} failed")
    result = figures(args, outcomes)
    progress.begin("picture")
    result["picture"] = draw(build(Robot, robot), outcomes, Path(args.results))
    progress.end("done" if result["picture"] else "no matplotlib")
    publish(NAME, result, report, started, args.results)
    return 0 if result["passed"] else 1


def _request(args: argparse.Namespace) -> "Request":
    from omniman_ros.lab.reproduce.scene_runs import Request

    return Request(args.robot, args.seed, args.solve_time)


def seeds_of(args: argparse.Namespace) -> range:
    """Return the seeds of the scenes: those named, or as many as requested from 0 on.

    Raises:
        CommandError: The options are refused.
    """
    if args.seeds is None:
        usual = QUICK if args.quick else FULL if args.full else COUNT
        count: int = usual if args.count is None else args.count
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


def driven(request: "Request", seeds: Sequence[int], jobs: int) -> Iterator[Outcome]:
    """Drive scenes in several processes.

    Args:
        request: How scenes are driven.
        seeds: Seeds of the scenes.
        jobs: Number of processes; 1: they are driven in this process.

    Yields:
        The outcomes, in the order of the seeds.
    """
    from omniman_ros.lab.reproduce.scene_runs import driver

    drive = driver(request)
    if jobs == 1:
        yield from map(drive, seeds)
        return
    os.environ.update(SINGLE_THREADED)  # read by libraries in the new interpreters
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(seeds)), mp_context=spawn) as pool:
        yield from pool.map(drive, seeds)


def figures(args: argparse.Namespace, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of all drives."""
    whole = summary(outcomes)
    met = aims(whole)
    return {
        "robot": args.robot,
        "seed": args.seed,
        "solve_time_s": args.solve_time,
        "limit_s": LIMIT,
        "groups": {n: summary(m) for n, m in groups(outcomes).items()},
        "aims": met,
        "passed": all(value is not False for value in met.values()),
        "failed": [o.scene.seed for o in outcomes if o.failed],
        "drives": [o.figures() for o in outcomes],
    }


def draw(robot: Robot, outcomes: Sequence[Outcome], folder: Path) -> str | None:
    """Draw some of the drives into a PNG file if matplotlib is installed; return its path."""
    try:
        from omniman_ros.lab.figures import scenes as scene_picture
    except ImportError:
        return None
    path = folder / f"{NAME}.png"
    scene_picture.draw(robot, chosen(outcomes, SHOWN), path)
    return str(path)


def chosen(outcomes: Sequence[Outcome], count: int) -> list[Outcome]:
    """Choose the drives to draw: those that failed, then those with the smallest gaps."""
    order = sorted(outcomes, key=lambda o: (not o.failed, not o.verdict.collided, o.verdict.gap))
    return order[:count]


# ---- the report ---------------------------------------------------------------------------------


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the tables."""
    rows: list[tuple[str, ...]] = [
        (
            "",
            "drives",
            "own contact",
            "other",
            "left area",
            "with a way",
            "reached",
            "of those",
            "time",
            "energy",
            "least gap",
            "answer",
            "p99",
            "max",
            "late",
        )
    ]
    rows += [_cells(name, group) for name, group in result["groups"].items()]
    lines = ["", *table(rows)]
    whole, met = result["groups"]["all"], result["aims"]
    rows = [("", "value", "aim", "")]
    for text, figure, aim, name in AIMS:
        value = whole[figure]
        shown = f"{100 * value:.1f} %" if isinstance(value, float) else str(value)
        rows.append((text, shown, aim, verdict(met[name])))
    lines += ["", *table(rows)]
    if result["failed"]:
        lines += ["", "Seeds that failed:"]
        lines += [
            f"  {_story(row)}" for row in result["drives"] if row["seed"] in result["failed"]
        ]
    if result["picture"]:
        lines += [f"Picture: {result['picture']}"]
    return lines


def _cells(name: str, group: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        name,
        str(group["drives"]),
        str(group["own_collisions"]),
        str(group["other_collisions"]),
        str(group["left_workspace"]),
        str(group["solvable"]),
        str(group["reached"]),
        f"{100 * group['reached_of_solvable']:.1f} %",
        f"{group['time_median_s']:.1f} s",
        f"{group['energy_median_j']:.0f} J",
        f"{1e3 * group['least_clearance_m']:.0f} mm",
        f"{group['answer_median_ms']:.1f} ms",
        f"{group['answer_p99_ms']:.1f} ms",
        f"{group['answer_max_ms']:.1f} ms",
        f"{group['late']} of {group['cycles']}",
    )


def _story(row: Mapping[str, Any]) -> str:
    """Describe a drive that failed in one sentence."""
    seen = f"seed {row['seed']}: "
    if row["collided"]:
        kind, number = row["touched"]
        whose = "its own" if row["own"] else "not avoidable"
        whose += ", though that had just turned" if row["surprised"] else ""
        seen += f"touched {kind} {number + 1} after {row['contact_s']:.2f} s, {whose}; "
    if row["outside_m"] > 0.0:
        seen += f"left the workspace by {1e3 * row['outside_m']:.0f} mm; "
    if not row["reached"] and not row["collided"]:
        seen += f"{row['off_m']:.2f} m from the goal after {row['time_s']:.1f} s, {row['last']}"
    return seen.rstrip("; ")
