"""The experiment of CCTA 2017, V.C over gains and random wheels: many drives, one table."""

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from statistics import fmean
from typing import Any

from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.coupling import GROUPS, Case, Run, Setup, draw_mismatch, drive
from omniman_ros.lab.studies.delay import Response, respond
from omniman_ros.motion.figure7 import Figure7

PAPER_GAIN = 2.0
"""k_epsilon of Fig. 7 [1/s]."""
AIM = 0.1
"""Aim: largest ratio of the coupling error to that without coupling control."""


@dataclass(frozen=True)
class Plan:
    """Extent of the sweep.

    Attributes:
        figure: The path in time.
        gains: Additional values of k_epsilon by group [1/s].
        samples: Number of sets of random wheels.
        delays: Additional delays of the commands in the tests on blocks [s].
    """

    figure: Figure7
    gains: Mapping[str, Sequence[float]]
    samples: int
    delays: Sequence[float]

    def gains_with(self, chosen: float) -> dict[str, list[float]]:
        """Return the gains by group, including 0, the paper's and the robot's own."""
        return {
            group: sorted({0.0, PAPER_GAIN, chosen, *gains}) for group, gains in self.gains.items()
        }


_FINE = (1.0, 3.0, 5.0, 8.0, 16.0, 20.0, 30.0, 50.0)

QUICK = Plan(Figure7(length=1.0), {"P": ()}, samples=1, delays=(0.05,))
STANDARD = Plan(
    Figure7(),
    {"P": (5.0, 20.0, 30.0), "PI": (5.0, 30.0), "radii": (), "ice": ()},
    samples=10,
    delays=(0.0, 0.02, 0.05),
)
FULL = Plan(
    Figure7(),
    {"P": _FINE, "PI": _FINE, "radii": (5.0, 30.0), "ice": (5.0, 30.0)},
    samples=20,
    delays=(0.0, 0.01, 0.02, 0.03, 0.05),
)


def cases(plan: Plan, robot: Mapping[str, Any], chosen: float, seed: int) -> list[Case]:
    """Return every drive of a plan, for the robot's own gain `chosen`."""
    wheels = build(Robot, robot).wheel_count
    return [
        Case(group, sample, gain, draw_mismatch(group, seed, sample, wheels))
        for group, gains in plan.gains_with(chosen).items()
        for sample in range(plan.samples)
        for gain in gains
    ]


def sweep(setup: Setup, chosen: Sequence[Case], workers: int) -> Iterator[Run]:
    """Drive cases in parallel; the number of workers does not change the figures.

    Args:
        setup: Robot and path.
        chosen: The cases.
        workers: Number of processes; 1: they are driven in this process.

    Yields:
        The drives, in the order of the cases.

    Raises:
        StudyError: See :func:`drive`.
    """
    if workers == 1:
        yield from map(partial(drive, setup), chosen)
        return
    # Each worker is a new interpreter: forking a process that may have threads is not safe.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context)
    try:
        yield from pool.map(partial(drive, setup), chosen)
    finally:
        pool.shutdown(cancel_futures=True)


def responses(plan: Plan, robot: Mapping[str, Any], chosen: float) -> list[Response]:
    """Measure step responses on blocks, over the plan's delays and the gains of group P."""
    gains = [gain for gain in plan.gains_with(chosen)["P"] if gain > 0.0]
    return [respond(robot, gain, delay) for delay in plan.delays for gain in gains]


def _spread(values: Sequence[float]) -> dict[str, float]:
    return {"mean": fmean(values), "worst": max(values, key=abs)}


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return mean and worst of each figure over the samples, in a row for each group and gain.

    `epsilon_ratio` is the ratio of a sample's epsilon_max to that of the same wheels without
    control.
    """
    table: dict[str, dict[float, list[Run]]] = {}
    for run in runs:
        table.setdefault(run.case.group, {}).setdefault(run.case.gain, []).append(run)
    rows = []
    for group, by_gain in table.items():
        off = [run.outcome.epsilon_max for run in by_gain[0.0]]
        for gain, same in sorted(by_gain.items()):
            largest = [run.outcome.epsilon_max for run in same]
            figures = {
                name: _spread([getattr(run.outcome, name) for run in same])
                for name in asdict(same[0].outcome)
            }
            ratio = [new / old for new, old in zip(largest, off, strict=True)]
            rows.append(
                {
                    "group": group,
                    "about": GROUPS[group].about,
                    "k": gain,
                    **figures,
                    "epsilon_ratio": _spread(ratio),
                    "epsilon_max_samples": largest,
                }
            )
    return rows
