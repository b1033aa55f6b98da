"""Services `~/pause`, `~/resume` and `~/cancel` of a node that executes motions."""

import functools
from collections.abc import Callable

from std_srvs.srv import Trigger

from omniman_ros.motion.path.interpolator import RefusedError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import MotionTimeBase


class MotionServices:
    """Serves requests that concern all motions of a node.

    Args:
        publish: Called after a request was accepted, so that it takes effect at once.
    """

    def __init__(
        self,
        node: OmnimanNode,
        time_base: MotionTimeBase,
        cancel: Callable[[], None],
        publish: Callable[[], None],
    ) -> None:
        self._node, self._publish = node, publish
        for name, request in (
            ("pause", time_base.pause),
            ("resume", time_base.resume),
            ("cancel", cancel),
        ):
            self.add(name, request, lambda: time_base.state.value)

    def add(self, name: str, request: Callable[[], None], answer: Callable[[], str]) -> None:
        """Serve `~/NAME`: a request that may raise RefusedError, and the answer after it."""
        serve = functools.partial(self._serve, request, answer)
        self._node.create_service(Trigger, f"~/{name}", serve)

    def _serve(
        self,
        request: Callable[[], None],
        answer: Callable[[], str],
        _: Trigger.Request,
        response: Trigger.Response,
    ) -> Trigger.Response:
        try:
            request()
        except RefusedError as error:
            response.success, response.message = False, str(error)
        else:
            self._publish()
            response.success, response.message = True, answer()
        return response
