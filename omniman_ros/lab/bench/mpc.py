"""`omniman bench mpc`: the planner's solver compared with IPOPT on the same problems.

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

if TYPE_CHECKING:  # the command line must do without casadi
    from omniman_ros.lab.studies.mpc_scenes import Controller, Rig

Case = tuple[int, int]
AIM_MEDIAN, AIM_P99 = 15.0, 10.0  # smallest ratios of IPOPT's CPU time to the solver's, main case
AIM_GROWTH = 2.5  # largest ratio of the median cycle time for N = 20 to that for N = 10
AIM_COST = 0.02  # largest median excess of the closed-loop cost over that with IPOPT, relative
WARM_UP = 5  # steps of each case that run before the measurement
LEAST_COST = 1.0  # lower bound of the reference cost to which a cost is relative [J]
MAIN: Case = (10, 4)  # to which most aims refer
STEPS_PER_SCENE = 60  # steps of a full drive, and most timed steps of a scene


@dataclass(frozen=True)
class Effort:
    """Cases of the solver alone and beside IPOPT, numbers of timed steps, and compared drives."""

    alone: Sequence[Case]
    peers: Sequence[Case]
    steps: int
    main_steps: int
    peer_steps: int
    scenes: int
    horizons: Sequence[int]
    drive: int
    folded: bool


GRID = tuple((steps, obstacles) for steps in (10, 20, 40) for obstacles in (0, 4, 10))
PEER_CASES = (MAIN, (10, 0), (10, 10), (20, 4))
QUICK = Effort(((10, 4), (20, 4)), (MAIN,), 12, 12, 12, 1, (10,), 10, False)
STANDARD = Effort(GRID, PEER_CASES, 100, 200, 15, 14, (10,), 40, True)
FULL = Effort(GRID, PEER_CASES, 200, 200, 200, 40, (10, 20), STEPS_PER_SCENE, True)


def case_name(case: Case) -> str:
    """Return the name of a case (N, M) in the results."""
    return f"N={case[0]} M={case[1]}"


def timing(steps: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Return the figures of steps, each with its CPU time [s] and whether it was solved.

    The time of a failed step counts too, as a robot also waits for it.
    """
    names = ("median_ms", "p99_ms", "max_ms")
    spread = dict(zip(names, percentiles_ms([seconds for seconds, _ in steps]), strict=True))
    failures = sum(not solved for _, solved in steps)
    return {**spread, "steps": len(steps), "failures": failures}


def measure_steps(rig: "Rig", count: int, beside: bool, folded: bool = False) -> dict[str, Any]:
    """Measure the CPU times of closed-loop steps, in which the planner's solver drives.

    IPOPT solves the same problems. Of the planner's solver, the figures under `cycle` include all
    computations of a planner's cycle; those under `solver` only what IPOPT's times include: from
    the initial guess and the parameters to the solution. IPOPT runs before each step of the
    planner's solver, so that the CPU's caches hold its data.
    """
    from omniman_ros.lab.bench.mpc_ipopt import Evaluator, Ipopt
    from omniman_ros.lab.studies.mpc_scenes import RealTime, arrived, draw_scene

    t, seed, seen = rig.transcription, 0, 0
    evaluator, peer = Evaluator(t), Ipopt(t, folded) if beside else None
    times: dict[str, list[tuple[float, bool]]] = {"cycle": [], "solver": [], "ipopt": []}
    above: list[float] = []
    excess = slack = 0.0
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
                times["cycle"].append((step.cycle_time, step.solved))
                times["solver"].append((step.solver_time, step.solved))
                excess, slack = max(excess, ours.excess), max(slack, float(ours.slack.max()))
            if peer is None:
                continue
            before = time.process_time()
            currents, solved = peer.plan(task)
            if counts:
                times["ipopt"].append((time.process_time() - before, solved))
            if counts and solved:
                best = evaluator.value(task.start, currents, task.stage).cost
                above.append((ours.cost - best) / max(best, LEAST_COST))
    result: dict[str, Any] = {name: timing(each) for name, each in times.items() if each}
    result |= {"largest_slack_m": slack, "largest_excess": excess}
    if above:
        median, p90 = (float(value) for value in np.percentile(above, (50.0, 90.0)))
        result["cost_of_a_step"] = {"median_above": median, "p90_above": p90}
    return result


def compare_drives(rig: "Rig", scenes: int, length: int) -> dict[str, Any]:
    """Compare the closed-loop cost of the planner's solver with that of converged IPOPT.

    Scenes and disturbances are the same for both. If the two drives pass an obstacle on different
    sides, they are near different local minima of the cost: such drives are counted, but their
    costs are not compared.
    """
    from omniman_ros.lab.bench.mpc_ipopt import Ipopt
    from omniman_ros.lab.studies.mpc_scenes import RealTime, draw_scene, same_sides, swept_angles

    controllers: list[Controller] = [RealTime(rig.solver), Ipopt(rig.transcription)]
    rows: list[tuple[float, bool]] = []
    for seed in range(scenes):
        scene = draw_scene(seed, rig.transcription.slots, rig.model.half)
        ours, theirs = (rig.drive(scene, controller, length) for controller in controllers)
        one, other = (swept_angles(d.times, d.poses, scene.ellipses) for d in (ours, theirs))
        rows.append((ours.cost / max(theirs.cost, LEAST_COST), same_sides(one, other)))
    return drive_statistics(rows)


def drive_statistics(rows: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Return statistics of cost ratios, each with whether both passed on the same sides."""
    same = [ratio for ratio, is_same in rows if is_same]
    return {
        "scenes": len(rows),
        "same_sides": len(same),
        "median_ratio": statistics.median(same) if same else None,
        "worst_ratio": max(same, default=None),
        "best_ratio": min(same, default=None),
        "other_sides_better": sum(ratio < 1.0 for ratio, is_same in rows if not is_same),
    }


def measure(robot: str, effort: Effort) -> dict[str, Any]:
    """Measure all cases and drives in this process."""
    from omniman_ros.lab.studies.mpc_scenes import Rig

    rig = cache(partial(Rig, load_robot(robot)))
    result: dict[str, Any] = {"alone": {}, "peers": {}, "closed_loop": {}}
    for case in effort.alone:
        say(f"{case_name(case)}, {effort.steps} steps ...")
        result["alone"][case_name(case)] = measure_steps(rig(*case), effort.steps, False)
    for case in effort.peers:
        count = effort.main_steps if case == MAIN else effort.peer_steps
        say(f"{case_name(case)}, {count} steps, beside IPOPT ...")
        folded = effort.folded and case == MAIN
        result["peers"][case_name(case)] = measure_steps(rig(*case), count, True, folded)
    for steps in effort.horizons:
        say(f"N={steps}, {effort.scenes} scenes, driven with our solver and with IPOPT ...")
        driven = compare_drives(rig(steps, MAIN[1]), effort.scenes, effort.drive)
        result["closed_loop"][f"N={steps}"] = driven
    return result


def ratios(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ratios of CPU times to which the aims refer; None for a case not measured."""
    main, alone = result["peers"][case_name(MAIN)], result["alone"]
    over: dict[str, Any] = {
        f"ipopt_over_{ours}": {
            key: main["ipopt"][f"{key}_ms"] / main[ours][f"{key}_ms"] for key in ("median", "p99")
        }
        for ours in ("cycle", "solver")
    }
    for name, more, less in (
        ("N=20_over_N=10", (20, 4), (10, 4)),
        ("M=10_over_M=4", (10, 10), (10, 4)),
    ):
        one, other = alone.get(case_name(more)), alone.get(case_name(less))
        known = one is not None and other is not None
        over[name] = one["cycle"]["median_ms"] / other["cycle"]["median_ms"] if known else None
    return over


def aims(result: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return whether each aim was met, or None for an aim that the figures cannot decide."""
    over = result["ratios"]
    # Neither IPOPT's time nor `solver` includes the choice of obstacles and the initial guess.
    ipopt, growth, more = (
        over[n] for n in ("ipopt_over_solver", "N=20_over_N=10", "M=10_over_M=4")
    )
    cost = [loop["median_ratio"] for loop in result["closed_loop"].values()]
    known = bool(cost) and None not in cost
    return {
        "median": ipopt["median"] >= AIM_MEDIAN,
        "p99": ipopt["p99"] >= AIM_P99,
        "steps": None if growth is None else growth <= AIM_GROWTH,
        "obstacles": None if more is None else more <= 10 / MAIN[1],
        "cost": max(cost) <= 1.0 + AIM_COST if known else None,
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench mpc`; return 0, the exit code of a successful measurement."""
    effort = QUICK if args.quick else FULL if args.full else STANDARD
    load_robot(args.robot)  # a wrong name raises an error here, not in a child process
    os.environ.update(SINGLE_THREADED)  # libraries in the child process read it
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            measured = pool.submit(partial(measure, args.robot, effort)).result()
        except (RuntimeError, ImportError) as error:
            raise CommandError(f"the solvers cannot be measured: {error}") from error
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, **measured}
    result["ratios"] = ratios(result)
    return conclude("mpc", result, report, args.results, aims)


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    times: Rows = [("CPU time [ms]", "median", "p99", "max", "failed")]
    for group, beside in (("alone", ""), ("peers", ", beside IPOPT")):
        for case, figures in result[group].items():
            for who in (name for name in ("cycle", "solver", "ipopt") if name in figures):
                each = figures[who]
                cells = (f"{each[f'{key}_ms']:.2f}" for key in ("median", "p99", "max"))
                failed = f"{each['failures']} of {each['steps']}"
                times.append((f"{case}{beside}: {who}", *cells, failed))
    rows: Rows = [("", "value", "aim", "")]
    over, met = result["ratios"], result["aims"]

    def row(text: str, value: float | None, aim: str = "", key: str = "") -> None:
        shown = "-" if value is None else f"{value:.3g}"
        rows.append((text, shown, aim, verdict(met[key]) if key else ""))

    ipopt, cycle = over["ipopt_over_solver"], over["ipopt_over_cycle"]
    name = case_name(MAIN)
    row(f"IPOPT over solver, median, {name}", ipopt["median"], f">= {AIM_MEDIAN:g}", "median")
    row("  p99", ipopt["p99"], f">= {AIM_P99:g}", "p99")
    row("IPOPT over whole cycle, median", cycle["median"])
    row("  p99", cycle["p99"])
    row("cycle, N=20 over N=10", over["N=20_over_N=10"], f"<= {AIM_GROWTH:g}", "steps")
    row("cycle, M=10 over M=4", over["M=10_over_M=4"], f"<= {10 / MAIN[1]:g}", "obstacles")
    for horizon, loop in result["closed_loop"].items():
        text = f"closed-loop cost over IPOPT's, {horizon}"
        row(text, loop["median_ratio"], f"<= {1 + AIM_COST:g}", "cost")
        other = loop["scenes"] - loop["same_sides"]
        row(f"  other sides in {other}: cheaper than IPOPT", loop["other_sides_better"])
    for case, figures in result["peers"].items():
        if "cost_of_a_step" in figures:
            above = figures["cost_of_a_step"]
            row(f"relative excess of a step's cost over IPOPT's, {case}", above["median_above"])
    return tables(times, rows)
