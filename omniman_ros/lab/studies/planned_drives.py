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
from omniman_ros.lab.studies.case_worlds import case_world
from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop, Trace
from omniman_ros.lab.studies.recorded_drive import Drive
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

RECORDING_TAIL = 2.0
"""Time for which a drive is recorded after the planner has finished, so that the robot can come to
rest [s]."""


@dataclass(frozen=True)
class PlannedDrive:
    """A drive with the MPC planner."""

    drive: Drive  # recorded drive of the robot
    trace: Trace  # record of the planner's cycles; its times count from when the goal was sent
    state: PlannerState  # state of the planner when it finished
    since: float  # time at which the goal was sent, on the clock of loop, plans and obstacles [s]
    touched: tuple[str, ...] = ()  # what the robot touched according to the physics world

    @property
    def collided(self) -> bool:
        """Whether the robot touched anything, by the true gaps or by the physics world."""
        return self.drive.collided or bool(self.touched)

    def figures(self) -> dict[str, Any]:
        """Return the figures of the drive for a result; their units are in their names."""
        drive, trace = self.drive, self.trace
        cpu_times = 1e3 * np.array([seconds for seconds in trace.planning_times if seconds > 0.0])
        reports = [trace.reports[i] for i in self.planning]
        error = drive.poses[-1] - drive.goal
        reached = math.isfinite(drive.arrival)
        return {
            "reached": reached,
            "collided": self.collided,
            "touched": list(self.touched),
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
            "cpu_median_ms": float(np.median(cpu_times)) if len(cpu_times) else math.nan,
            "cpu_p99_ms": float(np.percentile(cpu_times, 99)) if len(cpu_times) else math.nan,
        }

    @property
    def planning(self) -> list[int]:
        """Rows of the trace in which the planner planned.

        These are the rows in which it was driving or blocked, and the row after the last of them.
        """
        planning_states = (PlannerState.DRIVING, PlannerState.BLOCKED)
        rows = [i for i, state in enumerate(self.trace.states) if state in planning_states]
        final = rows[-1] + 1 if rows else 0  # the planner plans in the cycle of its arrival, too
        return rows + ([final] if 0 < final < len(self.trace.states) else [])

    def tracking(self) -> Array:
        """Return the true distances (k,) from the robot to its reference, by cycle [m]."""
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
    wheels: str | None = None,
) -> PlannedDrive:
    """Drive through a scene with the planner until it arrives, is blocked or runs out of time.

    Being blocked ends the drive only if all obstacles are at rest and there is no map.
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
            world=case_world(robot, wheels, scene) if wheels else None,
        ),
    )
    loop.planner.set_map(scene.grid)
    since = loop.now
    loop.drive(PoseGoal(np.array(scene.goal)))
    final_states = (PlannerState.ARRIVED, PlannerState.BLOCKED)
    # With a map, the search for another route may still succeed.
    unchanging = scene.grid is None and all(o.is_fixed for o in loop.obstacles)
    # Where obstacles move, the way of a blocked robot may become free again.
    end_states = final_states if unchanging else final_states[:1]
    loop.run(scene.time_limit, until=lambda: loop.planner.state in end_states)
    state = loop.planner.state
    loop.run(RECORDING_TAIL, until=lambda: False)
    trace = replace(loop.trace, times=[time - since for time in loop.trace.times])
    drive = Drive.of(
        loop.motion_record,
        since,
        scene.goal,
        parameters.arrival,
        loop.planner.model.half,
        scene.obstacles,
        scene.walls,
    )
    return PlannedDrive(drive, trace, state, since, tuple(loop.touched))
