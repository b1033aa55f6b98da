"""Step responses of the coupling control with delayed commands, as a measure of its stability.

On blocks, or on ice, only the drives slow the dynamics of the coupling error down. On the floor
the wheels constrain each other, which damps the loop; but a contact that slides damps less, so
that a large step can begin an oscillation where small errors die out.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.simulation.plant.parameters import SimulationParameters

SPEED = 0.4
"""Forward speed, which is reached within `RUN_UP` [m/s]."""
EPSILON_STEP = 0.2
"""Step of the coupling error epsilon, many counts of a coarse encoder [rad]."""
RUN_UP = 2.0
"""Time before the step [s]."""
RECORDED_TIME = 4.0
"""Time for which the response is recorded after the step [s]."""
SETTLED_SWING = 0.25
"""Ratio of the largest error in the last second to the step, below which epsilon counts as settled
[-]."""


@dataclass(frozen=True)
class Response:
    """Properties of a step response of the coupling error.

    Attributes:
        gain: k_epsilon [1/s].
        delay: Additional delay of the commands to the drives [s].
        lifted: Whether the wheels are off the floor.
        overshoot: Largest overshoot beyond zero, relative to the step [-].
        swing: Largest magnitude of the error in the last second, relative to the step [-].
    """

    gain: float
    delay: float
    lifted: bool
    overshoot: float
    swing: float

    @property
    def settled(self) -> bool:
        """Whether the error has died out rather than oscillating."""
        return self.swing < SETTLED_SWING


def step_response(
    robot: Mapping[str, Any], gain: float, delay: float, lifted: bool = True
) -> Response:
    """Measure the response to a step of the coupling error, at constant speed.

    The authority of the coupling controller is raised to 1 here, as a tighter bound would hide an
    unstable gain in a limit cycle.

    Args:
        robot: Parameters of the robot, full names to values.
        gain: k_epsilon [1/s].
        delay: Additional delay of the commands to the drives, rounded to whole ticks [s].
        lifted: Whether the wheels are off the floor, on blocks.
    """
    delay_ticks = round(delay / PERIOD)
    changes = {"coupling.k_epsilon": gain, "coupling.authority": 1.0}
    simulation = build(SimulationParameters, robot)
    simulation = replace(simulation, plant=replace(simulation.plant, lifted=lifted))
    loop = ClosedLoop(
        build(PlatformParameters, {**robot, **changes}), simulation, delay_ticks, torques=False
    )
    core = loop.controller
    twist = np.array([SPEED, 0.0, 0.0])
    errors = []
    before, after = round(RUN_UP / PERIOD), round(RECORDED_TIME / PERIOD)
    for tick in range(before + after):
        core.set_twist(twist, loop.now)
        if tick == before:
            core.cascade.coupling.reset()
            core.cascade.coupling.add(
                np.full(core.cascade.kinematics.constraint_count, EPSILON_STEP)
            )
        loop.step()
        errors.append(core.cascade.coupling.error)
    error = np.array(errors[before:]) / EPSILON_STEP
    last = error[-round(1.0 / PERIOD) :]
    return Response(
        gain,
        delay_ticks * PERIOD,
        lifted,
        max(float(-error.min()), 0.0),
        float(np.abs(last).max()),
    )
