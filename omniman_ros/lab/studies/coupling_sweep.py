"""The experiment of CCTA 2017, section V.C, for many gains and random wheels."""

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
from omniman_ros.lab.studies.delay import Response, step_response
from omniman_ros.motion.figure7 import Figure7

PAPER_GAIN = 2.0
"""k_epsilon in Fig. 7 of CCTA 2017 [1/s]."""
AIM = 0.1
"""Aim: largest ratio of the coupling error to the one without coupling control [-]."""


@dataclass(frozen=True)
class Plan:
    """Extent of a sweep.

    Attributes:
        figure: The path as a function of time.
        gains: Additional values of k_epsilon by group [1/s].
        samples: Number of sets of random wheels.
        delays: Additional delays of the commands in the tests on blocks [s].
    """

    figure: Figure7
    gains: Mapping[str, Sequence[float]]
    samples: int
    delays: Sequence[float]

    def gains_with(self, chosen: float) -> dict[str, list[float]]:
        """Return the gains by group [1/s]: those of the plan, 0, the paper's and the robot's own.

        Args:
            chosen: The robot's own gain [1/s].
        """
        return {
            group: sorted({0.0, PAPER_GAIN, chosen, *gains}) for group, gains in self.gains.items()
        }


_FINE_GAINS = (1.0, 3.0, 5.0, 8.0, 16.0, 20.0, 30.0, 50.0)
"""Values of k_epsilon in the full sweep [1/s]."""

QUICK = Plan(Figure7(length=1.0), {"P": ()}, samples=1, delays=(0.05,))
"""Sweep of a quick run: a short path and one set of wheels."""
STANDARD = Plan(
    Figure7(),
    {"P": (5.0, 20.0, 30.0), "PI": (5.0, 30.0), "radii": (), "ice": ()},
    samples=10,
    delays=(0.0, 0.02, 0.05),
)
"""Sweep of a standard run."""
FULL = Plan(
    Figure7(),
    {"P": _FINE_GAINS, "PI": _FINE_GAINS, "radii": (5.0, 30.0), "ice": (5.0, 30.0)},
    samples=20,
    delays=(0.0, 0.01, 0.02, 0.03, 0.05),
)
"""Sweep of a full run."""


def cases(plan: Plan, robot: Mapping[str, Any], chosen: float, seed: int) -> list[Case]:
    """Return the cases of all drives of a plan.

    Args:
        plan: Extent of the sweep.
        robot: Parameters of the robot, full names to values.
        chosen: The robot's own gain [1/s].
        seed: Seed of the random wheels.
    """
    wheels = build(Robot, robot).wheel_count
    return [
        Case(group, sample, gain, draw_mismatch(group, seed, sample, wheels))
        for group, gains in plan.gains_with(chosen).items()
        for sample in range(plan.samples)
        for gain in gains
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
    """Measure the step responses on blocks for the plan's delays and its gains of group P.

    Args:
        plan: Extent of the sweep.
        robot: Parameters of the robot, full names to values.
        chosen: The robot's own gain [1/s].
    """
    gains = [gain for gain in plan.gains_with(chosen)["P"] if gain > 0.0]
    return [step_response(robot, gain, delay) for delay in plan.delays for gain in gains]


def _mean_and_worst(values: Sequence[float]) -> dict[str, float]:
    """Return the mean of values, and the value of the largest magnitude."""
    return {"mean": fmean(values), "worst": max(values, key=abs)}


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return mean and worst value of each figure over the samples, by group and gain.

    Each row belongs to one group and gain. `epsilon_ratio` is the ratio of a sample's
    `epsilon_max` to the one of the same wheels without coupling control.
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
                name: _mean_and_worst([getattr(run.outcome, name) for run in same])
                for name in asdict(same[0].outcome)
            }
            ratio = [new / old for new, old in zip(largest, off, strict=True)]
            rows.append(
                {
                    "group": group,
                    "about": GROUPS[group].about,
                    "k": gain,
                    **figures,
                    "epsilon_ratio": _mean_and_worst(ratio),
                    "epsilon_max_samples": largest,
                }
            )
    return rows
