"""Stability margin of the coupling controller's gain when commands are delayed.

The wheels are off the floor. On the floor they constrain each other, which slows the loop of the
coupling error down and makes it robust; on blocks, or on ice, nothing but the drives does.
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
"""Forward speed, which is reached after `RUN_UP` [m/s]."""
OFFSET = 0.2
"""Step of epsilon that the controller must remove, many counts of a coarse encoder [rad]."""
RUN_UP = 2.0
"""Time before the step [s]."""
WATCHED = 4.0
"""Time after the step [s]."""
SETTLED = 0.25
"""Swing in the last second, relative to the step, below which epsilon counts as settled."""


@dataclass(frozen=True)
class Response:
    """Step response of the coupling error.

    Attributes:
        gain: k_epsilon [1/s].
        delay: Additional delay of the commands to the drives [s].
        overshoot: Overshoot beyond zero, relative to the step.
        swing: Largest error in the last second, relative to the step.
    """

    gain: float
    delay: float
    overshoot: float
    swing: float

    @property
    def settled(self) -> bool:
        """Whether the error does not oscillate."""
        return self.swing < SETTLED


def respond(robot: Mapping[str, Any], gain: float, delay: float) -> Response:
    """Measure the response to a step of the coupling error of a moving robot on blocks.

    The authority of the controller is not bounded here: a bound would hide an unstable gain in a
    limit cycle.

    Args:
        robot: Parameters of the robot, full names to values.
        gain: k_epsilon [1/s].
        delay: Additional delay of the commands, rounded to whole ticks [s].
    """
    late = round(delay / PERIOD)
    changes = {"coupling.k_epsilon": gain, "coupling.authority": 1.0}
    simulation = build(SimulationParameters, robot)
    lifted = replace(simulation, plant=replace(simulation.plant, lifted=True))
    loop = ClosedLoop(build(PlatformParameters, {**robot, **changes}), lifted, late, torques=False)
    core = loop.controller
    twist = np.array([SPEED, 0.0, 0.0])
    errors = []
    before, after = round(RUN_UP / PERIOD), round(WATCHED / PERIOD)
    for tick in range(before + after):
        core.set_twist(twist, loop.now)
        if tick == before:
            core.cascade.coupling.reset()
            core.cascade.coupling.add(np.full(core.cascade.kinematics.constraint_count, OFFSET))
        loop.step()
        errors.append(core.cascade.coupling.error)
    error = np.array(errors[before:]) / OFFSET
    last = error[-round(1.0 / PERIOD) :]
    return Response(gain, late * PERIOD, max(float(-error.min()), 0.0), float(np.abs(last).max()))
