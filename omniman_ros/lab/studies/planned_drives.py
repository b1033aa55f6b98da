"""Drives of the MPC planner through a scene on the simulated, slipping plant."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop, Trace
from omniman_ros.lab.studies.recorded_drive import Drive
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

WATCHED = 2.0
"""Time for which the drive is recorded after the planner is done, so that the robot can come to
rest [s]."""


@dataclass(frozen=True)
class PlannedDrive:
    """A drive that the planner has led.

    Attributes:
        drive: What the robot did.
        trace: Trace of the planner; its times are since the robot was sent off.
        state: State of the planner at the end.
        since: Time on the clock of the loop, its plans and its obstacles at which the robot was
            sent off [s].
    """

    drive: Drive
    trace: Trace
    state: PlannerState
    since: float

    def figures(self) -> dict[str, Any]:
        """Return the figures of the drive for a result; their units are in their names."""
        drive, trace = self.drive, self.trace
        cycles = [i for i, spent in enumerate(trace.spent) if spent > 0.0]
        spent = 1e3 * np.array([trace.spent[i] for i in cycles])
        reports = [trace.reports[i] for i in self.planning]
        error = drive.poses[-1] - drive.goal
        reached = math.isfinite(drive.arrival)
        return {
            "reached": reached,
            "collided": drive.collided,
            "state": self.state.value,
            "time_s": drive.arrival,
            "energy_j": drive.energy_until_rest() if reached else math.nan,
            "clearance_m": drive.clearance,
            "off_m": float(np.hypot(error[0], error[1])),
            "off_rad": float(abs(se2.wrap(error[2]))),
            "tracking_m": float(self.tracking().max(initial=0.0)),
            "cycles": len(reports),
            "plans_used": sum(report.used for report in reports),
            "brakings": sum(report.braking for report in reports),
            "cpu_median_ms": float(np.median(spent)) if len(spent) else math.nan,
            "cpu_p99_ms": float(np.percentile(spent, 99)) if len(spent) else math.nan,
        }

    @property
    def planning(self) -> list[int]:
        """Rows of the trace in which the planner was driving or blocked, and the one after."""
        on_its_way = (PlannerState.DRIVING, PlannerState.BLOCKED)
        rows = [i for i, state in enumerate(self.trace.states) if state in on_its_way]
        first = rows[-1] + 1 if rows else 0  # the cycle of the arrival has planned, too
        return rows + ([first] if 0 < first < len(self.trace.states) else [])

    def tracking(self) -> Array:
        """Return the true distances (k,) of the robot from its reference [m]."""
        rows = self.planning
        errors = np.array([self.trace.poses[i] - self.trace.references[i] for i in rows])
        result: Array = np.hypot(*errors.reshape(-1, 3)[:, :2].T)
        return result


def drive_with_planner(
    robot: Mapping[str, Any],
    scene: Scene,
    voltages: bool = False,
    seed: int = 0,
    timer: Callable[[], float] | None = None,
) -> PlannedDrive:
    """Let the planner drive through a scene until it arrives or abandons the goal.

    Args:
        robot: Parameters of the robot, full names to values.
        scene: The scene.
        voltages: Whether the planner's motor voltages are applied, instead of its reference being
            followed.
        seed: Seed of the noise of the observations.
        timer: Clock by which planning is measured [s]; None if it is not measured.
    """
    values = {**robot, **scene.changes}
    parameters = build(PlannerParameters, values)
    loop = MpcLoop(
        parameters,
        build(PlatformParameters, robot),
        build(SimulationParameters, {}),
        LoopOptions(
            start=scene.start,
            obstacles=scene.obstacles,
            voltages=voltages,
            noise=scene.noise,
            seed=seed,
            timer=timer,
        ),
    )
    loop.planner.set_map(scene.grid)
    since = loop.now
    loop.drive(PoseGoal(np.array(scene.goal)))
    given_up = (PlannerState.ARRIVED, PlannerState.BLOCKED)
    # With a map, a search for another route may still succeed.
    standing = scene.grid is None and not any(
        np.ptp([o.place(0.0), o.place(1.0)], axis=0).any() for o in loop.obstacles
    )
    # Where obstacles move, a blocked robot may become free again.
    ends = given_up if standing else given_up[:1]
    loop.run(scene.time_limit, until=lambda: loop.planner.state in ends)
    state = loop.planner.state
    loop.run(WATCHED, until=lambda: False)
    trace = replace(loop.trace, times=[time - since for time in loop.trace.times])
    drive = Drive.of(
        loop.course,
        since,
        scene.goal,
        parameters.arrival,
        loop.planner.model.half,
        scene.obstacles,
        scene.walls,
    )
    return PlannedDrive(drive, trace, state, since)
