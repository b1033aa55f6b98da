"""How far a gain of the coupling controller is from oscillating, when commands come late.

The wheels are off the floor. On it they hold each other, which slows the coupling error's loop
down and so forgives a lot; on blocks, or on ice, nothing but the drives does.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from omniman_ros.core.parameters import build
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.studies.closed_loop import PERIOD, ClosedLoop

SPEED = 0.4
"""Forwards [m/s]; reached after RUN_UP."""
OFFSET = 0.2
"""Step of epsilon that is to be taken out: many counts of a coarse encoder [rad]."""
RUN_UP = 2.0
WATCHED = 4.0
"""Time before and after the step [s]."""
SETTLED = 0.25
"""Swing in the last second, over the step, below which epsilon is said to have settled."""


@dataclass(frozen=True)
class Response:
    """Answer of the coupling error to a step.

    Attributes:
        gain: k_epsilon [1/s].
        delay: By which commands reach the drives later than they do anyway [s].
        overshoot: Beyond zero, over the step.
        swing: Largest error in the last second, over the step.
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
    """Add a step to the coupling error of a robot on blocks at speed, and watch.

    The authority is not bounded here: a bound would hide an unstable gain in a limit cycle.

    Args:
        robot: Full parameter names to values.
        gain: k_epsilon [1/s].
        delay: Of commands [s], rounded to whole ticks.
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
        core.hear_twist(twist, loop.now)
        if tick == before:
            core.cascade.coupling.reset()
            core.cascade.coupling.add(np.full(core.cascade.kinematics.constraint_count, OFFSET))
        loop.step()
        errors.append(core.cascade.coupling.error)
    error = np.array(errors[before:]) / OFFSET
    last = error[-round(1.0 / PERIOD) :]
    return Response(gain, late * PERIOD, max(float(-error.min()), 0.0), float(np.abs(last).max()))
