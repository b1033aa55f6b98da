"""Goals of the action `follow_path`, which the platform's paths serve."""

from typing import Any

import numpy as np

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.path_interface import PathInterface

SAMPLES = 100  #: Number of poses by which the length of the rest of a path is measured


class PathExecutor:
    """Hands goals of an action to the platform's paths; see `NavigationExecutor`."""

    def __init__(self, context: MotionContext, path: PathInterface) -> None:
        self._context, self._path = context, path

    def send(self, request: Any) -> int:
        """Follow the path of a goal, and return the path's number.

        `controller_id` and the checkers of goal and progress name plugins of Nav2, and count for
        nothing here.
        """
        refusal = self._path.accept(request.path)
        if refusal:
            raise InputError(refusal)
        return self._path.ledger.accepted

    def outcome(self, motion: int) -> str | None:
        """Return why a path ended: empty if it was driven; None while it waits or goes on."""
        return self._path.ledger.outcome_so_far(
            motion, is_driven=not self._path.idle, is_pending=bool(self._path.pending)
        )

    def cancel(self, motion: int) -> None:
        """Discard the path if it waits, or bring the platform to rest on it."""
        ledger = self._path.ledger
        if motion == ledger.accepted and self._path.discard_pending():
            return
        if motion == ledger.started and not self._path.idle:
            self._path.core.cancel(self._context.time_base.now())
            self._context.on_started()

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the length of the rest of the path, and the speed, into the feedback."""
        core, now = self._path.core, self._context.time_base.now()
        if self._path.idle:
            return False
        ahead = core.sample(np.linspace(now, now + core.remaining(now), SAMPLES))[0]
        steps = np.diff(ahead[:, :2], axis=0)
        feedback.distance_to_goal = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        feedback.speed = float(np.hypot(*self._context.odom.velocity[:2]))
        return True
