"""`omniman bench mpc`: the planner's solver compared with acados and IPOPT on the same problems.

acados solves the same quadratic program with compiled functions; IPOPT solves to convergence. Each
case is named by the number N of steps of its horizon and the number M of its obstacles.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_least,
    at_most,
    conclude,
)
from omniman_ros.lab.measurement import spread_ms
from omniman_ros.lab.sweep import Sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import robot_parameters

if TYPE_CHECKING:  # the command line must do without casadi
    from omniman_ros.lab.bench.mpc_rig import Plan, Rig, Task

AIM_MEDIAN, AIM_P99 = 15.0, 10.0  #: smallest ratios of IPOPT's CPU time to the solver's, main case
AIM_GROWTH = 2.5  #: largest ratio of the median cycle for N = 20 to N = 10, and M = 10 to M = 4
AIM_COMPILED = 1.0  #: smallest ratio of acados' CPU time to that of the compiled solver
AIM_COST = 1.02  #: largest median ratio of the closed-loop cost to that with IPOPT
WARM_UP = 5  #: number of steps of each case that run before the measurement
LEAST_COST = 1.0  #: lower bound of the reference cost to which a cost is relative [J]
MAIN, LONGER, MORE = "N=10 M=4", "N=20 M=4", "N=10 M=10"
CASES = {MAIN: (10, 4), LONGER: (20, 4), MORE: (10, 10)}  #: (N, M) by name
ACADOS_CASES = (MAIN, LONGER)  #: cases in which the solver runs beside acados
STEPS_PER_SCENE = 60  #: steps of a full drive, and most timed steps of a scene
REACHED_DISTANCE = 0.03  #: from the goal, where the problem becomes trivial [m]

#: A peer: from a task to whether it is solved, and the CPU time of that [s]
Peer = Callable[["Task"], tuple[bool, float]]


class MpcBenchmarkSize(NamedTuple):
    """Extent of the measurement."""

    cases: Sequence[str]  #: cases in which the solver runs alone; beside IPOPT, the main one
    steps: int  #: number of timed steps of each
    horizons: Sequence[str]  #: cases in which whole drives are compared with IPOPT's
    scenes: int  #: number of drives
    drive: int  #: number of steps of a drive


QUICK = MpcBenchmarkSize((MAIN, LONGER), 12, (MAIN,), 1, 10)
STANDARD = MpcBenchmarkSize(tuple(CASES), 200, (MAIN,), 14, 40)
FULL = MpcBenchmarkSize(tuple(CASES), 200, (MAIN, LONGER), 40, STEPS_PER_SCENE)


def timed(plan: "Plan") -> Peer:
    """Return a solver of this process as a peer."""

    def solve(task: "Task") -> tuple[bool, float]:
        before = time.process_time()
        _, solved = plan(task)
        return solved, time.process_time() - before

    return solve


def measure_steps(rig: "Rig", count: int, peers: Mapping[str, Peer]) -> dict[str, Any]:
    """Measure the CPU times of closed-loop steps, in which the planner's solver drives.

    Peers solve the same problems. Of the planner's solver, the figures under `cycle` include all
    computations of a planner's cycle; those under `solver` only what the times of peers include:
    from the initial guess and the parameters to the solution. Peers run before each step of the
    planner's solver, so that the CPU's caches hold their data. The time of a failed step counts,
    too, as a robot also waits for it.
    """
    seed, seen = 0, 0
    times = {name: list[tuple[float, bool]]() for name in ("cycle", "solver", *peers)}
    while seen < WARM_UP + count:
        scene = rig.scene(seed)
        seed += 1
        for step in rig.steps(scene, rig.plan, STEPS_PER_SCENE, time.process_time):
            task = step.task
            away = task.start[:2] - task.stage.target[-1, :2]
            if seen >= WARM_UP + count or np.hypot(*away) < REACHED_DISTANCE:
                break
            seen += not task.first  # the first step of a scene takes more iterations
            counts = seen > WARM_UP and not task.first
            if counts:
                times["cycle"].append((step.cycle_time, step.solved))
                times["solver"].append((step.solver_time, step.solved))
            for name, peer in peers.items():
                solved, seconds = peer(task)
                if counts:
                    times[name].append((seconds, solved))
    return {
        name: {
            **spread_ms([seconds for seconds, _ in steps]),
            "steps": len(steps),
            "failures": sum(not solved for _, solved in steps),
        }
        for name, steps in times.items()
    }


def measure_acados(rig: "Rig", count: int) -> dict[str, Any]:
    """Measure steps as :func:`measure_steps`, beside acados."""
    from omniman_ros.lab.bench.mpc_acados import AcadosClient

    with AcadosClient(rig.transcription) as acados:
        return measure_steps(rig, count, {"acados": lambda task: acados.plan(task)[1:]})


def measure_compiled(robot: str, case: str, count: int) -> dict[str, Any] | None:
    """Measure steps with compiled functions, beside acados if it is installed.

    The result is None where nothing can be compiled.
    """
    from omniman_ros.lab.bench.mpc_acados import is_installed
    from omniman_ros.lab.bench.mpc_rig import Rig

    rig = Rig(robot_parameters(robot), *CASES[case])
    if not rig.compile():
        return None
    return measure_acados(rig, count) if is_installed() else measure_steps(rig, count, {})


def compare_drives(rig: "Rig", scenes: int, length: int) -> dict[str, Any]:
    """Compare the closed-loop cost of the planner's solver with that of converged IPOPT.

    Scenes and disturbances are the same for both. If the two drives pass an obstacle on different
    sides, they are near different local minima of the cost: such drives are counted, but their
    costs are not compared.
    """
    from omniman_ros.lab.bench.mpc_ipopt import Ipopt

    peer, rows = Ipopt(rig.transcription), []
    for seed in range(scenes):
        scene = rig.scene(seed)
        ours, theirs = (rig.drive(scene, plan, length) for plan in (rig.plan, peer.plan))
        same = bool((np.abs(ours[1] - theirs[1]) < np.pi).all())
        rows.append((ours[0] / max(theirs[0], LEAST_COST), same))
    return drive_statistics(rows)


def drive_statistics(rows: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Return statistics of cost ratios, each with whether both passed on the same sides."""
    same = [ratio for ratio, is_same in rows if is_same]
    return {
        "scenes": len(rows),
        "same_sides": len(same),
        "median_ratio": statistics.median(same) if same else None,
        "worst_ratio": max(same, default=None),
        "other_sides_better": sum(ratio < 1.0 for ratio, is_same in rows if not is_same),
    }


def measure(robot: str, effort: MpcBenchmarkSize) -> dict[str, Any]:
    """Measure all cases and drives in this process, and acados in another one."""
    from omniman_ros.lab.bench.mpc_acados import is_installed
    from omniman_ros.lab.bench.mpc_ipopt import Ipopt
    from omniman_ros.lab.bench.mpc_rig import Rig

    rig = cache(lambda case: Rig(robot_parameters(robot), *CASES[case]))
    groups = "alone", "beside", "acados", "compiled", "closed_loop"
    result: dict[str, Any] = {group: {} for group in groups}
    for case in effort.cases:
        say(f"{case}, {effort.steps} steps ...")
        result["alone"][case] = measure_steps(rig(case), effort.steps, {})
    for case in ACADOS_CASES if is_installed() else ():
        say(f"{case}, {effort.steps} steps, beside acados ...")
        result["acados"][case] = measure_acados(rig(case), effort.steps)
    for case in ACADOS_CASES:
        say(f"{case}, {effort.steps} steps, with compiled functions ...")
        if measured := measure_compiled(robot, case, effort.steps):
            result["compiled"][case] = measured
    say(f"{MAIN}, {effort.steps} steps, beside IPOPT ...")
    ipopt = timed(Ipopt(rig(MAIN).transcription).plan)
    result["beside"][MAIN] = measure_steps(rig(MAIN), effort.steps, {"ipopt": ipopt})
    for case in effort.horizons:
        say(f"{case}, {effort.scenes} scenes, driven with our solver and with IPOPT ...")
        result["closed_loop"][case] = compare_drives(rig(case), effort.scenes, effort.drive)
    return result


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench mpc`; return 0, the exit code of a successful measurement."""
    effort = QUICK if args.quick else FULL if args.full else STANDARD
    robot_parameters(args.robot)  # a wrong name raises an error here, not in a child process
    try:
        (measured,) = Sweep(1).map(partial(measure, args.robot), [effort])
    except (RuntimeError, ImportError) as error:
        raise CommandError(f"the solvers cannot be measured: {error}") from error
    result = {"robot": args.robot, "quick": args.quick, **measured}
    return conclude("mpc", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    times = []
    groups = {
        "alone": "",
        "acados": ", beside acados",
        "compiled": ", compiled",
        "beside": ", beside IPOPT",
    }
    for group, text in groups.items():
        for case, figures in result[group].items():
            for who, each in figures.items():
                cells = [f"{each[f'{key}_ms']:.2f}" for key in ("median", "p99", "max")]
                cells.append(f"{each['failures']} of {each['steps']}")
                times.append(Figure(f"{case}{text}: {who}", cells))
    if not result["acados"]:
        times.append(Figure("acados", ("not installed",)))
    main, rows = result["beside"][MAIN], []
    over = {
        who: {key: main["ipopt"][key] / main[who][key] for key in ("median_ms", "p99_ms")}
        for who in ("solver", "cycle")
    }
    about = f"IPOPT over solver, {{}}, {MAIN}".format
    rows.append(at_least(about("median"), over["solver"]["median_ms"], AIM_MEDIAN))
    rows.append(at_least(about("p99"), over["solver"]["p99_ms"], AIM_P99))
    for case in ACADOS_CASES:
        beside, compiled = result["acados"].get(case), result["compiled"].get(case, {})
        for key in ("median_ms", "p99_ms"):
            about_acados = f"acados over {{}}, {key.removesuffix('_ms')}, {case}".format
            ratio = beside and f"{beside['acados'][key] / beside['solver'][key]:.3g}"
            rows.append(Figure(about_acados("solver"), (ratio or verdict(None),)))
            is_known = "acados" in compiled
            over_compiled = compiled["acados"][key] / compiled["solver"][key] if is_known else None
            rows.append(at_least(about_acados("compiled solver"), over_compiled, AIM_COMPILED))
    for key, value in over["cycle"].items():
        about_cycle = f"IPOPT over whole cycle, {key.removesuffix('_ms')}"
        rows.append(Figure(about_cycle, (f"{value:.3g}",)))
    medians = {case: each["cycle"]["median_ms"] for case, each in result["alone"].items()}
    for case in (LONGER, MORE):
        growth = medians[case] / medians[MAIN] if case in medians else None
        rows.append(at_most(f"cycle, {case} over {MAIN}", growth, AIM_GROWTH))
    for case, loop in result["closed_loop"].items():
        text = f"closed-loop cost over IPOPT's, {case}"
        rows.append(at_most(text, loop["median_ratio"], AIM_COST))
        text = f"  other sides in {loop['scenes'] - loop['same_sides']}: cheaper than IPOPT"
        rows.append(Figure(text, (str(loop["other_sides_better"]),)))
    return [
        BenchmarkTable(("CPU time, median [ms]", "p99", "max", "failed"), times),
        BenchmarkTable(("value",), rows),
    ]
