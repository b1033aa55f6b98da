"""`omniman bench mpc`: the planner's solver against IPOPT and fatrop on the same problems."""

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
from omniman_ros.lab.bench.measurement import SINGLE_THREADED, percentiles_ms
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

if TYPE_CHECKING:
    from omniman_ros.lab.studies.mpc_scenes import Controller, Rig

AIM_MEDIAN = 15.0
"""Aim: least ratio of IPOPT's median time to the planner's, for N = 10 with four obstacles."""
AIM_P99 = 10.0
"""Aim: least ratio of IPOPT's p99 time to the planner's, for N = 10 with four obstacles."""
AIM_DOUBLE = 2.5
"""Aim: largest ratio of the time for N = 20 to that for N = 10."""
AIM_COST = 0.02
"""Aim: largest median excess of the closed-loop cost over that with IPOPT run to convergence."""
WARM_UP = 5
"""Steps of each case that do not count."""
LEAST_COST = 1.0
"""Floor of the reference cost in a comparison of costs [J]."""
WORSE = 0.02
"""Share of the cost above which two costs count as different."""
GRID = tuple((steps, obstacles) for steps in (10, 20, 40) for obstacles in (0, 4, 10))
"""Steps N and obstacles M of the cases."""
MAIN = (10, 4)
"""The case that most aims are about."""
AMONG_PEERS = (MAIN, (10, 0), (10, 10), (20, 4))
"""Cases that IPOPT and fatrop solve, too."""
PEERS = ("ipopt", "fatrop")
"""Solvers that the planner's is compared with."""
PER_SCENE = 60
"""Steps of a drive, and most steps of a scene that are timed."""


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement.

    Attributes:
        grid: Cases of the planner's solver alone.
        peers: Cases that the other solvers solve, too.
        steps: Timed steps of a case of the planner's solver alone.
        main_steps: Timed steps of the main case with the other solvers.
        peer_steps: Timed steps of the other cases with the other solvers.
        scenes: Number of scenes driven with the planner's solver and with IPOPT.
        horizons: Horizons N of these drives, with four obstacles each.
        drive: Steps of a drive.
        folded: Whether the other solvers get functions with folded constants in the main case.
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
STANDARD = Effort(GRID, AMONG_PEERS, 100, 200, 15, 14, (10,), 40, True)
FULL = Effort(GRID, AMONG_PEERS, 200, 200, 200, 40, (10, 20), PER_SCENE, True)


def name(case: tuple[int, int]) -> str:
    """Return the name of a case in the results."""
    return f"N={case[0]} M={case[1]}"


def spread(seconds: Sequence[float]) -> dict[str, float]:
    """Return the median, p99 and largest of times [s], in milliseconds."""
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
        """Add a step; failed steps count in the times as well, as a robot waits for them, too."""
        self.times.append(seconds)
        self.failures += not solved

    def summary(self) -> dict[str, Any]:
        """Return the figures for the results."""
        return {**spread(self.times), "steps": len(self.times), "failures": self.failures}


def timed(
    rig: "Rig", count: int, peers: Sequence[str], folded: bool = False, seed: int = 0
) -> dict[str, Any]:
    """Measure the CPU times of closed-loop steps that the planner's solver drives.

    The other solvers solve the same problems. Of the planner's solver, `cycle` includes all that
    a planner's cycle costs; `solver` is what the other solvers' times include, too: from the
    guess and the stage to the answer. The other solvers ran before each step, so that the caches
    hold their data.

    Args:
        rig: The problem.
        count: Number of steps that count, after the warm-up.
        peers: Names of the other solvers.
        folded: Whether the other solvers' functions are folded.
        seed: Seed of the first scene.
    """
    from omniman_ros.lab.studies.mpc_peers import Converged, Evaluator, Peer
    from omniman_ros.lab.studies.mpc_scenes import RealTime, arrived, draw_scene

    t = rig.transcription
    evaluator = Evaluator(t)
    others = {
        peer: Converged(Peer(t, peer, folded=folded), dual=peer == "ipopt") for peer in peers
    }
    timings = {who: Timing() for who in ("cycle", "solver", *peers)}
    above: list[float] = []
    excess, slack, seen = 0.0, 0.0, 0
    while seen < WARM_UP + count:
        scene = draw_scene(seed, t.slots, rig.model.half)
        seed += 1
        for step in rig.cycles(scene, RealTime(rig.solver), PER_SCENE, time.process_time):
            if seen >= WARM_UP + count or arrived(step):
                break
            task = step.task
            seen += not task.first  # the first is a new problem, with more iterations
            counts = seen > WARM_UP and not task.first
            ours = evaluator.value(task.start, step.currents, task.stage)
            if counts:
                timings["cycle"].add(step.whole, step.solved)
                timings["solver"].add(step.alone, step.solved)
                excess, slack = max(excess, ours.excess), max(slack, float(ours.slack.max()))
            for peer, controller in others.items():
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
        result["cost_of_a_step"] = compared(above)
    return result


def compared(above: Sequence[float]) -> dict[str, float]:
    """Return statistics of the excess of costs over IPOPT's optimum, as shares of it."""
    excesses = np.array(above)
    median, p90 = np.percentile(excesses, (50.0, 90.0))
    return {
        "steps": len(excesses),
        "median_above": float(median),
        "p90_above": float(p90),
        "share_worse": float((excesses > WORSE).mean()),
        "share_better": float((excesses < -WORSE).mean()),
    }


def driven(rig: "Rig", scenes: int, length: int, seed: int = 0) -> dict[str, Any]:
    """Compare the closed-loop cost with that of IPOPT run to convergence.

    Scenes and disturbances are the same. Where the two passed an obstacle on different sides, they
    drove in different valleys of the cost: such drives are counted, but not compared.

    Args:
        rig: The problem.
        scenes: Number of scenes.
        length: Steps of a drive.
        seed: Seed of the first scene.
    """
    from omniman_ros.lab.studies.mpc_peers import Converged, Peer
    from omniman_ros.lab.studies.mpc_scenes import RealTime, draw_scene, same_sides, swept_angles

    slots = rig.transcription.slots
    controllers: dict[str, Controller] = {
        "ours": RealTime(rig.solver),
        "ipopt": Converged(Peer(rig.transcription, "ipopt"), dual=True),
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
    return summed(rows)


def summed(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return statistics of the ratios of all scenes."""
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
    """Measure everything, in this process."""
    from omniman_ros.lab.studies.mpc_scenes import Rig

    rig = cache(partial(Rig, load_robot(robot)))
    result: dict[str, Any] = {"alone": {}, "peers": {}, "closed_loop": {}}
    for case in effort.grid:
        say(f"{name(case)}, {effort.steps} steps ...")
        result["alone"][name(case)] = timed(rig(*case), effort.steps, ())
    for case in effort.peers:
        count = effort.main_steps if case == MAIN else effort.peer_steps
        say(f"{name(case)}, {count} steps, next to {' and '.join(PEERS)} ...")
        result["peers"][name(case)] = timed(
            rig(*case), count, PEERS, effort.folded and case == MAIN
        )
    for steps in effort.horizons:
        say(f"N={steps}, {effort.scenes} scenes, driven with either ...")
        result["closed_loop"][f"N={steps}"] = driven(
            rig(steps, MAIN[1]), effort.scenes, effort.drive
        )
    return result


def ratios(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ratios that the aims are about."""
    main, alone = result["peers"][name(MAIN)], result["alone"]
    over: dict[str, Any] = {
        f"{peer}_over_{ours}": {
            key: main[peer][f"{key}_ms"] / main[ours][f"{key}_ms"] for key in ("median", "p99")
        }
        for peer in PEERS
        for ours in ("cycle", "solver")
    }

    def growth(more: tuple[int, int], less: tuple[int, int]) -> float | None:
        cases = alone.get(name(more)), alone.get(name(less))
        if cases[0] is None or cases[1] is None:
            return None
        return float(cases[0]["cycle"]["median_ms"] / cases[1]["cycle"]["median_ms"])

    steps, obstacles = MAIN
    over["N=20_over_N=10"] = growth((20, obstacles), (10, obstacles))
    over["N=40_over_N=20"] = growth((40, obstacles), (20, obstacles))
    over["M=10_over_M=4"] = growth((steps, 10), (steps, 4))
    return over


def aims(result: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return which aims were met; None where too little was measured to say."""
    over = result["ratios"]
    # IPOPT's time includes neither the choice of obstacles nor the guess: nor does `solver`.
    ipopt, growth = over["ipopt_over_solver"], over["N=20_over_N=10"]
    cost = [loop["median_ratio"] for loop in result["closed_loop"].values()]
    known = bool(cost) and None not in cost
    more = over["M=10_over_M=4"]
    return {
        "median": ipopt["median"] >= AIM_MEDIAN,
        "p99": ipopt["p99"] >= AIM_P99,
        "steps": None if growth is None else growth <= AIM_DOUBLE,
        "obstacles": None if more is None else more <= 10 / MAIN[1],
        "cost": max(cost) <= 1.0 + AIM_COST if known else None,
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench mpc`; return 0 if it could be measured, whatever the figures."""
    effort = QUICK if args.quick else FULL if getattr(args, "full", False) else STANDARD
    load_robot(args.robot)  # reports a wrong name here, not in a child process
    os.environ.update(SINGLE_THREADED)  # read by libraries in the new interpreter
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
    """Return the lines of the tables."""
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
        for text, who in (("cycle, beside others", "cycle"), ("solver alone", "solver")):
            row(f"{case}, {text}", figures[who])
        for peer in PEERS:
            row(f"{'':{len(case)}}  {peer}", figures[peer])
    return rows


def _aim_rows(result: Mapping[str, Any]) -> Rows:
    compare: Rows = [("", "value", "aim", "")]
    over, met = result["ratios"], result["aims"]

    def against(text: str, value: float | None, aim: str, key: str) -> None:
        shown = "-" if value is None else f"{value:.3g}"
        compare.append((text, shown, aim, verdict(met[key])))

    ipopt = over["ipopt_over_solver"]
    against(
        f"IPOPT's over our solver's, median, {name(MAIN)}",
        ipopt["median"],
        f">= {AIM_MEDIAN:g}",
        "median",
    )
    against("  p99", ipopt["p99"], f">= {AIM_P99:g}", "p99")
    cycle = over["ipopt_over_cycle"]
    compare.append(("IPOPT's over our whole cycle's, median", f"{cycle['median']:.3g}", "", ""))
    compare.append(("  p99", f"{cycle['p99']:.3g}", "", ""))
    against("N=20 over N=10", over["N=20_over_N=10"], f"<= {AIM_DOUBLE:g}", "steps")
    against("M=10 over M=4", over["M=10_over_M=4"], f"<= {10 / MAIN[1]:g}", "obstacles")
    for horizon, loop in result["closed_loop"].items():
        against(
            f"closed-loop cost over IPOPT's, {horizon}",
            loop["median_ratio"],
            f"<= {1 + AIM_COST:g}",
            "cost",
        )
        others = loop["scenes"] - loop["same_sides"]
        compare.append(
            (
                f"  other sides, {others} of {loop['scenes']} scenes: cheaper",
                f"{loop['other_sides_better']}",
                "",
                "",
            )
        )
    for case, figures in result["peers"].items():
        if "cost_of_a_step" in figures:
            step = figures["cost_of_a_step"]
            compare.append(
                (
                    f"cost of a step above IPOPT's, median, {case}",
                    f"{100 * step['median_above']:.2f} %",
                    "",
                    "",
                )
            )
            compare.append(("  p90", f"{100 * step['p90_above']:.2f} %", "", ""))
    return compare
