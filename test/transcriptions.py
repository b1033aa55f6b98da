"""Optimisation problems of the planner: built once, and shared by all tests of a session."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from omniman_ros.nodes.mpc_planner import compiled_functions
from omniman_ros.planning import plan_optimizer
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.transcription import Transcription


def fraction(patch: pytest.MonkeyPatch) -> None:
    """Have planners of the same robot and horizon use the same problems.

    The problems of a planner take a second of CPU time to build, and are functions without state;
    their solvers are each planner's own.
    """
    built: dict[tuple[Any, ...], Transcription] = {}

    def transcription(
        model: PlanningModel, steps: int, step: float, slots: int, confined: bool
    ) -> Transcription:
        values = (np.asarray(getattr(model, field.name)).tobytes() for field in fields(model))
        key = (*values, steps, step, slots, confined)
        if key not in built:
            built[key] = Transcription(model, steps, step, slots, confined)
        return built[key]

    patch.setattr(plan_optimizer, "Transcription", transcription)
    patch.setattr(compiled_functions, "COMPILER", "no_compiler_in_tests")
