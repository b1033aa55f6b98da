"""The experiment of CCTA 2017, section V.C, for many gains and random wheels."""

import math
import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from statistics import fmean
from typing import Any, TypeVar

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.coupling import (
    GROUPS,
    OWN_CONTROLLER,
    PAPER_CONTROLLER,
    Case,
    Run,
    Setup,
    draw_mismatch,
    drive,
)
from omniman_ros.lab.studies.coupling_loop import CouplingLoop
from omniman_ros.lab.studies.delay import Response, step_response
from omniman_ros.motion.figure7 import Figure7

PAPER_GAIN = 2.0
"""k_epsilon in Fig. 7 of CCTA 2017 [1/s]."""
AIM = 0.1
"""Aim: largest ratio of the coupling error to the one without coupling control [-]."""
RATIOS = {"epsilon": "epsilon_max", "error": "error_max", "energy": "energy"}
"""Figures of a drive that are related to those without coupling control, by name of the ratio."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def printed_gain(robot: Mapping[str, Any]) -> float | None:
    """Return the gain k_epsilon with which (18) as printed acts like the paper's gain [1/s].

    The printed last column of J_a is (1/r)(1, 1, -1, -1), and T times this column is 4 / r instead
    of 1: with the corrected J_a, the paper's gain times 4 / r is the same controller.

    Args:
        robot: Parameters of the robot, full names to values.

    Returns:
        The gain; None if the wheels are not those of (15) to (18), four of equal radius with
        T = (1, 1, -1, -1).
    """
    wheels = build(Robot, robot).wheels
    constraints = PlatformKinematics(wheels).T
    equal = len(set(wheels.radius)) == 1
    if constraints.shape != (1, 4) or not equal or not np.allclose(abs(constraints), 1.0):
        return None
    return PAPER_GAIN * 4.0 / wheels.radius[0]


@dataclass(frozen=True)
class Plan:
    """Extent of a sweep.

    Attributes:
        figure: The path as a function of time.
        gains: Additional values of k_epsilon by group [1/s].
        samples: Number of sets of random wheels.
        step_gains: Additional values of k_epsilon in the step responses [1/s].
        delays: Additional delays of the commands in the step responses [s].
    """

    figure: Figure7
    gains: Mapping[str, Sequence[float]]
    samples: int
    step_gains: Sequence[float]
    delays: Sequence[float]

    def gains_with(self, chosen: float) -> dict[str, list[float]]:
        """Return the gains by group [1/s]: those of the plan, 0, the paper's and the robot's own.

        Args:
            chosen: The robot's own gain [1/s].
        """
        return {
            group: sorted({0.0, PAPER_GAIN, chosen, *gains}) for group, gains in self.gains.items()
        }


_FINE_GAINS = (1.0, 3.0, 5.0, 8.0, 16.0, 20.0, 30.0, 50.0, 100.0)
"""Values of k_epsilon in the full sweep [1/s]."""
_STEP_GAINS = (5.0, 10.0, 20.0, 30.0, 45.0, 90.0, 130.0, 180.0, 270.0, 400.0)
"""Values of k_epsilon in the step responses [1/s]."""
_STEP_DELAYS = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1)
"""Delays of the commands in the step responses [s]."""

QUICK = Plan(Figure7(length=1.0), {"P": ()}, samples=1, step_gains=(30.0,), delays=(0.05,))
"""Sweep of a quick run: a short path and one set of wheels."""
STANDARD = Plan(
    Figure7(),
    {"P": (5.0, 20.0, 30.0), "PI": (5.0, 30.0), "torque": (), "radii": (), "ice": (), "late": ()},
    samples=10,
    step_gains=_STEP_GAINS,
    delays=_STEP_DELAYS,
)
"""Sweep of a standard run."""
FULL = Plan(
    Figure7(),
    {
        "P": _FINE_GAINS,
        "PI": _FINE_GAINS,
        "torque": (5.0, 30.0),
        "radii": (5.0, 30.0),
        "ice": (5.0, 30.0),
        "late": (5.0, 30.0),
    },
    samples=20,
    step_gains=_STEP_GAINS,
    delays=tuple(0.005 * ticks for ticks in range(21)),
)
"""Sweep of a full run."""


def cases(plan: Plan, robot: Mapping[str, Any], chosen: float, seed: int) -> list[Case]:
    """Return the cases of all drives of a plan.

    The paper's controller drives with the paper's gain, and with the one that acts like (18) as
    printed.

    Args:
        plan: Extent of the sweep.
        robot: Parameters of the robot, full names to values.
        chosen: The robot's own gain [1/s].
        seed: Seed of the random wheels.
    """
    wheels = build(Robot, robot).wheel_count
    printed = printed_gain(robot)
    paper = [(PAPER_CONTROLLER, gain) for gain in (PAPER_GAIN, printed) if gain is not None]
    return [
        Case(group, sample, gain, draw_mismatch(group, seed, sample, wheels), controller)
        for group, gains in plan.gains_with(chosen).items()
        for sample in range(plan.samples)
        for controller, gain in [*((OWN_CONTROLLER, gain) for gain in gains), *paper]
    ]


def sweep(setup: Setup, chosen: Sequence[Case], workers: int) -> Iterator[Run]:
    """Drive cases in parallel; the results do not depend on the number of workers.

    Args:
        setup: Robot and path.
        chosen: The cases.
        workers: Number of processes; with 1, the cases are driven in this process.

    Yields:
        The drives, in the order of the cases.

    Raises:
        StudyError: A drive was stopped before its end, see `coupling.drive`.
    """
    yield from _in_parallel(partial(drive, setup), chosen, workers)


def _in_parallel(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int
) -> Iterator[Result]:
    """Yield the results of a function for items, in their order.

    Args:
        function: Function that can be pickled.
        items: Its arguments.
        workers: Number of processes; with 1, the function runs in this process.
    """
    if workers == 1:
        yield from map(function, items)
        return
    # Each worker is a new interpreter: forking a process that may have threads is not safe.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context)
    try:
        yield from pool.map(function, items)
    finally:
        pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class Step:
    """One step response of the study.

    Attributes:
        gain: k_epsilon [1/s].
        delay: Additional delay of the commands [s].
        lifted: Whether the wheels are off the floor.
    """

    gain: float
    delay: float
    lifted: bool


def step_grid(plan: Plan, robot: Mapping[str, Any], chosen: float) -> list[Step]:
    """Return the step responses of a plan: all its delays and gains, on blocks and on the floor.

    Args:
        plan: Extent of the sweep.
        robot: Parameters of the robot, full names to values.
        chosen: The robot's own gain [1/s].
    """
    named = {PAPER_GAIN, chosen, *plan.step_gains, printed_gain(robot) or chosen}
    return [
        Step(gain, delay, lifted)
        for lifted in (True, False)
        for delay in plan.delays
        for gain in sorted(named)
    ]


def responses(robot: Mapping[str, Any], grid: Sequence[Step], workers: int) -> Iterator[Response]:
    """Measure step responses in parallel.

    Args:
        robot: Parameters of the robot, full names to values.
        grid: The step responses.
        workers: Number of processes.

    Yields:
        The responses, in the order of the grid.
    """
    yield from _in_parallel(partial(_respond, dict(robot)), grid, workers)


def _respond(robot: Mapping[str, Any], step: Step) -> Response:
    return step_response(robot, step.gain, step.delay, step.lifted)


def stability(
    robot: Mapping[str, Any], measured: Sequence[Response], gains: Sequence[float]
) -> dict[str, Any]:
    """Compute the stability of the loop, wheels off the floor, and compare it with measurements.

    Args:
        robot: Parameters of the robot, full names to values.
        measured: Step responses; those on the floor are not compared.
        gains: Gains whose delay margins are computed [1/s].

    Returns:
        For the JSON: `boundary`, the computed critical gain by delay; `margins`, the computed
        longest delay by gain, and between which delays of the grid the loop began to oscillate;
        `compared`, the number of step responses on blocks, and `agree`, of how many the model
        says rightly whether they settle.
    """
    loop = CouplingLoop(robot)
    lifted = [response for response in measured if response.lifted]
    longest = max((response.delay for response in lifted), default=0.0)
    agree = [
        (loop.growth(response.gain, response.delay) < 1.0) == response.settled
        for response in lifted
    ]
    delays = np.linspace(0.0, longest, 41)
    return {
        "boundary": [
            {"delay_s": float(delay), "k": _finite(loop.critical_gain(delay))} for delay in delays
        ],
        "margins": [
            {"k": gain, "computed_s": _finite(loop.delay_margin(gain)), **_bracket(lifted, gain)}
            for gain in sorted(set(gains))
        ],
        "compared": len(agree),
        "agree": sum(agree),
    }


def _finite(value: float) -> float | None:
    """Return a value, or None if it is not finite."""
    return value if math.isfinite(value) else None


def _bracket(lifted: Sequence[Response], gain: float) -> dict[str, float | None]:
    """Return the longest delay up to which a gain settles, and the shortest with which it doesn't.

    Args:
        lifted: Step responses with the wheels off the floor.
        gain: k_epsilon [1/s].

    Returns:
        The delays `settles_s` and `oscillates_s`; None where none was measured [s].
    """
    same = [response for response in lifted if response.gain == gain]
    oscillating = min((step.delay for step in same if not step.settled), default=None)
    settled = [
        step.delay
        for step in same
        if step.settled and (oscillating is None or step.delay < oscillating)
    ]
    return {"settles_s": max(settled, default=None), "oscillates_s": oscillating}


def _mean_and_worst(values: Sequence[float]) -> dict[str, float]:
    """Return the mean of values, and the value of the largest magnitude."""
    return {"mean": fmean(values), "worst": max(values, key=abs)}


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return mean and worst value of each figure over the samples, by group and gain.

    Each row belongs to one group, controller and gain. `epsilon_ratio`, `error_ratio` and
    `energy_ratio` are the ratios of a sample's `epsilon_max`, `error_max` and `energy` to those of
    the same wheels without coupling control.
    """
    table: dict[str, dict[tuple[str, float], list[Run]]] = {}
    for run in runs:
        key = (run.case.controller, run.case.gain)
        table.setdefault(run.case.group, {}).setdefault(key, []).append(run)
    rows = []
    for group, by_gain in table.items():
        off = by_gain[OWN_CONTROLLER, 0.0]
        for (controller, gain), same in sorted(by_gain.items()):
            largest = [run.outcome.epsilon_max for run in same]
            figures = {
                name: _mean_and_worst([getattr(run.outcome, name) for run in same])
                for name in asdict(same[0].outcome)
            }
            ratios = {
                f"{name}_ratio": _mean_and_worst(
                    [
                        getattr(new.outcome, figure) / getattr(old.outcome, figure)
                        for new, old in zip(same, off, strict=True)
                    ]
                )
                for name, figure in RATIOS.items()
            }
            rows.append(
                {
                    "group": group,
                    "about": GROUPS[group].about,
                    "controller": controller,
                    "k": gain,
                    **figures,
                    **ratios,
                    "epsilon_max_samples": largest,
                }
            )
    return rows
