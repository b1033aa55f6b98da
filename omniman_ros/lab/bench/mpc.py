"""`omniman bench mpc`: the planner's solver compared with IPOPT and fatrop on the same problems.

Each case is named by the number N of steps of its horizon and the number M of its obstacles.
"""

import argparse
import multiprocessing
import os
import statistics
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.lab.bench.harness import Rows, conclude, tables
from omniman_ros.lab.measurement import SINGLE_THREADED, percentiles_ms
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

if TYPE_CHECKING:
    from omniman_ros.lab.studies.mpc_scenes import Controller, Rig

AIM_MEDIAN = 15.0
"""Aim: smallest ratio of IPOPT's median CPU time to that of the planner's solver, main case."""
AIM_P99 = 10.0
"""Aim: smallest ratio of IPOPT's p99 CPU time to that of the planner's solver, main case."""
AIM_GROWTH = 2.5
"""Aim: largest ratio of the planner's median cycle time for N = 20 to that for N = 10."""
AIM_COST = 0.02
"""Aim: largest median excess of the closed-loop cost, relative to that with converged IPOPT."""
WARM_UP = 5
"""Number of steps of each case that run before the measurement."""
LEAST_COST = 1.0
"""Lower bound of the reference cost to which a cost is relative [J]."""
COST_TOLERANCE = 0.02
"""Relative difference up to which two costs count as equal."""
GRID = tuple((steps, obstacles) for steps in (10, 20, 40) for obstacles in (0, 4, 10))
"""Cases (N, M) of the planner's solver alone: steps and obstacles."""
MAIN = (10, 4)
"""The main case (N, M), to which most aims refer."""
PEER_CASES = (MAIN, (10, 0), (10, 10), (20, 4))
"""Cases (N, M) that IPOPT and fatrop also solve."""
PEERS = ("ipopt", "fatrop")
"""Names of the general solvers with which the planner's solver is compared."""
STEPS_PER_SCENE = 60
"""Number of steps of a full drive, and largest number of timed steps of a scene."""


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement.

    Attributes:
        grid: Cases (N, M) that only the planner's solver solves.
        peers: Cases (N, M) that the general solvers also solve.
        steps: Number of timed steps of each case in `grid`.
        main_steps: Number of timed steps of the main case in `peers`.
        peer_steps: Number of timed steps of each other case in `peers`.
        scenes: Number of scenes driven with the planner's solver and with IPOPT.
        horizons: Numbers N of steps of the horizon in these drives, with four obstacles each.
        drive: Number of steps of a drive.
        folded: Whether the general solvers' functions compute common subexpressions only once in
            the main case; this makes them faster, but takes seconds to build.
    """

    grid: Sequence[tuple[int, int]]
    peers: Sequence[tuple[int, int]]
    steps: int
    main_steps: int
    peer_steps: int
    scenes: int
    horizons: Sequence[int]
    drive: int
    folded: bool


QUICK = Effort(((10, 4), (20, 4)), (MAIN,), 12, 12, 12, 1, (10,), 10, False)
"""Extent with `--quick`."""
STANDARD = Effort(GRID, PEER_CASES, 100, 200, 15, 14, (10,), 40, True)
"""Extent without options."""
FULL = Effort(GRID, PEER_CASES, 200, 200, 200, 40, (10, 20), STEPS_PER_SCENE, True)
"""Extent with `--full`."""


def case_name(case: tuple[int, int]) -> str:
    """Return the name of a case (N, M) in the results."""
    return f"N={case[0]} M={case[1]}"


def spread(seconds: Sequence[float]) -> dict[str, float]:
    """Return the median, the 99th percentile and the maximum [ms] of times [s]."""
    return dict(zip(("median_ms", "p99_ms", "max_ms"), percentiles_ms(seconds), strict=True))


class Timing:
    """Collects the CPU times of one solver.

    Attributes:
        times: CPU times of the steps [s].
        failures: Number of steps without a solution.
    """

    def __init__(self) -> None:
        self.times: list[float] = []
        self.failures = 0

    def add(self, seconds: float, solved: bool) -> None:
        """Add a step; the time of a failed step counts too, as a robot also waits for it.

        Args:
            seconds: CPU time of the step [s].
            solved: Whether the solver found a solution.
        """
        self.times.append(seconds)
        self.failures += not solved

    def summary(self) -> dict[str, Any]:
        """Return the figures of all steps."""
        return {**spread(self.times), "steps": len(self.times), "failures": self.failures}


def measure_steps(
    rig: "Rig", count: int, peers: Sequence[str], folded: bool = False, seed: int = 0
) -> dict[str, Any]:
    """Measure the CPU times of closed-loop steps, in which the planner's solver drives.

    The general solvers solve the same problems. Of the planner's solver, the figures under `cycle`
    include all computations of a planner's cycle; those under `solver` include only what the times
    of the general solvers include: from the initial guess and the parameters to the solution. The
    general solvers run before each step of the planner's solver, so that the CPU's caches hold
    their data.

    Args:
        rig: The problem.
        count: Number of measured steps, after the warm-up.
        peers: Names of the general solvers.
        folded: Whether the general solvers' functions compute common subexpressions only once.
        seed: Seed of the first scene.

    Returns:
        Figures of each solver, largest slack [m], largest relative violation of a limit and, with
        IPOPT, statistics of the excess of the cost over IPOPT's.
    """
    from omniman_ros.lab.studies.mpc_general_solvers import (
        ConvergedController,
        Evaluator,
        GeneralSolver,
    )
    from omniman_ros.lab.studies.mpc_scenes import RealTime, arrived, draw_scene

    t = rig.transcription
    evaluator = Evaluator(t)
    general = {
        peer: ConvergedController(GeneralSolver(t, peer, cse=folded), dual=peer == "ipopt")
        for peer in peers
    }
    timings = {who: Timing() for who in ("cycle", "solver", *peers)}
    above: list[float] = []
    excess, slack, seen = 0.0, 0.0, 0
    while seen < WARM_UP + count:
        scene = draw_scene(seed, t.slots, rig.model.half)
        seed += 1
        for step in rig.cycles(scene, RealTime(rig.solver), STEPS_PER_SCENE, time.process_time):
            if seen >= WARM_UP + count or arrived(step):
                break
            task = step.task
            seen += not task.first  # the first step of a scene takes more iterations
            counts = seen > WARM_UP and not task.first
            ours = evaluator.value(task.start, step.currents, task.stage)
            if counts:
                timings["cycle"].add(step.cycle_time, step.solved)
                timings["solver"].add(step.solver_time, step.solved)
                excess, slack = max(excess, ours.excess), max(slack, float(ours.slack.max()))
            for peer, controller in general.items():
                before = time.process_time()
                currents, solved = controller.plan(task)
                cpu_time = time.process_time() - before
                if not counts:
                    continue
                timings[peer].add(cpu_time, solved)
                if peer == "ipopt" and solved:
                    best = evaluator.value(task.start, currents, task.stage)
                    above.append((ours.cost - best.cost) / max(best.cost, LEAST_COST))
    result: dict[str, Any] = {who: timing.summary() for who, timing in timings.items()}
    result |= {"largest_slack_m": slack, "largest_excess": excess}
    if above:
        result["cost_of_a_step"] = cost_statistics(above)
    return result


def cost_statistics(above: Sequence[float]) -> dict[str, float]:
    """Return statistics of the excess of costs over IPOPT's optimum.

    Args:
        above: Excess of the cost of each step, relative to IPOPT's optimum.
    """
    excesses = np.array(above)
    median, p90 = np.percentile(excesses, (50.0, 90.0))
    return {
        "steps": len(excesses),
        "median_above": float(median),
        "p90_above": float(p90),
        "share_worse": float((excesses > COST_TOLERANCE).mean()),
        "share_better": float((excesses < -COST_TOLERANCE).mean()),
    }


def compare_drives(rig: "Rig", scenes: int, length: int, seed: int = 0) -> dict[str, Any]:
    """Compare the closed-loop cost of the planner's solver with that of converged IPOPT.

    Scenes and disturbances are the same for both. If the two drives pass an obstacle on different
    sides, they are near different local minima of the cost: such drives are counted, but their
    costs are not compared.

    Args:
        rig: The problem.
        scenes: Number of scenes.
        length: Number of steps of a drive.
        seed: Seed of the first scene.

    Returns:
        Figures of all scenes; see `drive_statistics`.
    """
    from omniman_ros.lab.studies.mpc_general_solvers import ConvergedController, GeneralSolver
    from omniman_ros.lab.studies.mpc_scenes import RealTime, draw_scene, same_sides, swept_angles

    slots = rig.transcription.slots
    controllers: dict[str, Controller] = {
        "ours": RealTime(rig.solver),
        "ipopt": ConvergedController(GeneralSolver(rig.transcription, "ipopt"), dual=True),
    }
    rows: list[dict[str, Any]] = []
    for number in range(seed, seed + scenes):
        scene = draw_scene(number, slots, rig.model.half)
        drives = {
            who: rig.drive(scene, controller, length) for who, controller in controllers.items()
        }
        ours, theirs = drives["ours"], drives["ipopt"]
        angles = [swept_angles(d.times, d.poses, scene.ellipses) for d in (ours, theirs)]
        rows.append(
            {
                "seed": number,
                "ratio": ours.cost / max(theirs.cost, LEAST_COST),
                "same_sides": same_sides(angles[0], angles[1]),
                "cost_J": {who: d.cost for who, d in drives.items()},
                "slack_m": {who: d.slack for who, d in drives.items()},
                "distance_m": {who: d.distance for who, d in drives.items()},
                "failures": {who: d.failures for who, d in drives.items()},
            }
        )
    return drive_statistics(rows)


def drive_statistics(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return statistics of the cost ratios of the planner's solver to IPOPT in all scenes.

    Args:
        rows: Figures of the pair of drives in each scene.
    """
    same = [row["ratio"] for row in rows if row["same_sides"]]
    other = [row["ratio"] for row in rows if not row["same_sides"]]
    return {
        "scenes": len(rows),
        "same_sides": len(same),
        "median_ratio": statistics.median(same) if same else None,
        "worst_ratio": max(same) if same else None,
        "best_ratio": min(same) if same else None,
        "other_sides_better": sum(ratio < 1.0 for ratio in other),
        "other_sides_worse": sum(ratio >= 1.0 for ratio in other),
        "failures": {who: sum(row["failures"][who] for row in rows) for who in ("ours", "ipopt")},
        "drives": list(rows),
    }


def measure(robot: str, effort: Effort) -> dict[str, Any]:
    """Measure all cases and drives in this process.

    Args:
        robot: Name of the robot, or the path of its file.
        effort: Extent of the measurement.

    Raises:
        RuntimeError: casadi lacks one of the solvers.
        ImportError: casadi is not installed.
    """
    from omniman_ros.lab.studies.mpc_scenes import Rig

    rig = cache(partial(Rig, load_robot(robot)))
    result: dict[str, Any] = {"alone": {}, "peers": {}, "closed_loop": {}}
    for case in effort.grid:
        say(f"{case_name(case)}, {effort.steps} steps ...")
        result["alone"][case_name(case)] = measure_steps(rig(*case), effort.steps, ())
    for case in effort.peers:
        count = effort.main_steps if case == MAIN else effort.peer_steps
        say(f"{case_name(case)}, {count} steps, compared with {' and '.join(PEERS)} ...")
        result["peers"][case_name(case)] = measure_steps(
            rig(*case), count, PEERS, effort.folded and case == MAIN
        )
    for steps in effort.horizons:
        say(f"N={steps}, {effort.scenes} scenes, driven with our solver and with IPOPT ...")
        result["closed_loop"][f"N={steps}"] = compare_drives(
            rig(steps, MAIN[1]), effort.scenes, effort.drive
        )
    return result


def ratios(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ratios of CPU times to which the aims refer.

    Args:
        result: Figures that `measure` returns.

    Returns:
        Ratios by name; None if one of the two cases was not measured.
    """
    main, alone = result["peers"][case_name(MAIN)], result["alone"]
    over: dict[str, Any] = {
        f"{peer}_over_{ours}": {
            key: main[peer][f"{key}_ms"] / main[ours][f"{key}_ms"] for key in ("median", "p99")
        }
        for peer in PEERS
        for ours in ("cycle", "solver")
    }

    def growth(more: tuple[int, int], less: tuple[int, int]) -> float | None:
        cases = alone.get(case_name(more)), alone.get(case_name(less))
        if cases[0] is None or cases[1] is None:
            return None
        return float(cases[0]["cycle"]["median_ms"] / cases[1]["cycle"]["median_ms"])

    steps, obstacles = MAIN
    over["N=20_over_N=10"] = growth((20, obstacles), (10, obstacles))
    over["N=40_over_N=20"] = growth((40, obstacles), (20, obstacles))
    over["M=10_over_M=4"] = growth((steps, 10), (steps, 4))
    return over


def aims(result: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return whether each aim was met, or None for an aim that the figures cannot decide."""
    over = result["ratios"]
    # Neither IPOPT's time nor `solver` includes the choice of obstacles and the initial guess.
    ipopt, growth = over["ipopt_over_solver"], over["N=20_over_N=10"]
    cost = [loop["median_ratio"] for loop in result["closed_loop"].values()]
    known = bool(cost) and None not in cost
    more = over["M=10_over_M=4"]
    return {
        "median": ipopt["median"] >= AIM_MEDIAN,
        "p99": ipopt["p99"] >= AIM_P99,
        "steps": None if growth is None else growth <= AIM_GROWTH,
        "obstacles": None if more is None else more <= 10 / MAIN[1],
        "cost": max(cost) <= 1.0 + AIM_COST if known else None,
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench mpc`; return 0, the exit code of a successful measurement.

    Raises:
        CommandError: The solvers cannot be measured.
    """
    effort = QUICK if args.quick else FULL if getattr(args, "full", False) else STANDARD
    load_robot(args.robot)  # a wrong name raises an error here, not in a child process
    os.environ.update(SINGLE_THREADED)  # libraries in the child process read it
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            measured = pool.submit(partial(measure, args.robot, effort)).result()
        except (RuntimeError, ImportError) as error:
            raise CommandError(f"the solvers cannot be measured: {error}") from error
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, **measured}
    result["ratios"] = ratios(result)
    return conclude("mpc", result, report, args.results, aims)


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    return tables(_time_rows(result), _aim_rows(result))


def _time_rows(result: Mapping[str, Any]) -> Rows:
    rows: Rows = [("CPU time [ms]", "median", "p99", "max", "failed")]

    def row(text: str, figures: Mapping[str, Any]) -> None:
        cells = (f"{figures[f'{key}_ms']:.2f}" for key in ("median", "p99", "max"))
        rows.append((text, *cells, f"{figures['failures']} of {figures['steps']}"))

    for case, figures in result["alone"].items():
        row(f"{case}, cycle", figures["cycle"])
        row(f"{'':{len(case)}}  solver alone", figures["solver"])
    for case, figures in result["peers"].items():
        for text, who in (("cycle, beside other solvers", "cycle"), ("solver alone", "solver")):
            row(f"{case}, {text}", figures[who])
        for peer in PEERS:
            row(f"{'':{len(case)}}  {peer}", figures[peer])
    return rows


def _aim_rows(result: Mapping[str, Any]) -> Rows:
    rows: Rows = [("", "value", "aim", "")]
    over, met = result["ratios"], result["aims"]

    def compare_with_aim(text: str, value: float | None, aim: str, key: str) -> None:
        shown = "-" if value is None else f"{value:.3g}"
        rows.append((text, shown, aim, verdict(met[key])))

    ipopt = over["ipopt_over_solver"]
    compare_with_aim(
        f"CPU time of IPOPT over our solver's, median, {case_name(MAIN)}",
        ipopt["median"],
        f">= {AIM_MEDIAN:g}",
        "median",
    )
    compare_with_aim("  p99", ipopt["p99"], f">= {AIM_P99:g}", "p99")
    cycle = over["ipopt_over_cycle"]
    rows.append(
        ("CPU time of IPOPT over our whole cycle's, median", f"{cycle['median']:.3g}", "", "")
    )
    rows.append(("  p99", f"{cycle['p99']:.3g}", "", ""))
    compare_with_aim(
        "CPU time of a cycle, N=20 over N=10",
        over["N=20_over_N=10"],
        f"<= {AIM_GROWTH:g}",
        "steps",
    )
    compare_with_aim(
        "CPU time of a cycle, M=10 over M=4",
        over["M=10_over_M=4"],
        f"<= {10 / MAIN[1]:g}",
        "obstacles",
    )
    for horizon, loop in result["closed_loop"].items():
        compare_with_aim(
            f"closed-loop cost over IPOPT's, {horizon}",
            loop["median_ratio"],
            f"<= {1 + AIM_COST:g}",
            "cost",
        )
        other_sides = loop["scenes"] - loop["same_sides"]
        rows.append(
            (
                f"  other sides in {other_sides} of {loop['scenes']} scenes: cheaper than IPOPT",
                f"{loop['other_sides_better']}",
                "",
                "",
            )
        )
    for case, figures in result["peers"].items():
        if "cost_of_a_step" in figures:
            step = figures["cost_of_a_step"]
            rows.append(
                (
                    f"excess of a step's cost over IPOPT's, median, {case}",
                    f"{100 * step['median_above']:.2f} %",
                    "",
                    "",
                )
            )
            rows.append(("  p90", f"{100 * step['p90_above']:.2f} %", "", ""))
    return rows
