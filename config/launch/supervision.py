"""Supervision of the nodes of a robot under launch, as `omniman up` supervises them.

The end of a node that the robot needs stops the robot, and launch ends with exit code 1. Nodes are
stopped stage by stage: a drive runs until the nodes that command it have come to rest and ended.

The launch files load this module by its path. It needs nothing but launch, because `ros2 launch`
may be another Python than the one that omniman_ros is installed for.
"""

import os
import signal
from collections.abc import Iterable
from typing import Any

from launch import LaunchContext
from launch.actions import EmitEvent
from launch.events import matches_action
from launch.events.process import ProcessExited, ShutdownProcess
from launch.logging import get_logger
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PARENT_VARIABLE = "OMNIMAN_PARENT"
"""Environment variable that makes a node of omniman_ros end with the process whose id it holds.

The node also leaves that process's group, so that only launch tells it to stop."""
STOP_TIMEOUT = "20"
"""Time after its SIGINT at which a node gets SIGTERM, and no longer comes to rest [s]."""
ENDED_BY_REQUEST = (0, -signal.SIGINT, -signal.SIGTERM, -signal.SIGALRM)
"""Exit codes of a node that was asked to end and left nothing undone.

SIGINT and SIGTERM end one that has not begun to work, SIGALRM one that has come to rest, but whose
middleware does not shut down."""


class Crew:
    """The nodes of one robot.

    Attributes:
        members: The nodes.
        failures: How nodes ended that did not come to rest after they were asked to.
    """

    def __init__(self) -> None:
        self.members: list[SupervisedNode] = []
        self.failures: list[str] = []

    def may_stop(self, node: "SupervisedNode") -> bool:
        """Return whether all nodes of earlier stages have ended."""
        return not any(member.is_running for member in self.members if member.stage < node.stage)

    def stop_next(self) -> Iterable[EmitEvent]:
        """Return the actions that stop the nodes whose turn has come.

        Raises:
            RuntimeError: No node runs any more, and one of them did not come to rest.
        """
        running = [member for member in self.members if member.is_running]
        if not running and self.failures:
            raise RuntimeError(f"not stopped in order: {', '.join(self.failures)}")
        # launch asks a node only once, however often this event comes.
        return [
            EmitEvent(event=ShutdownProcess(process_matcher=matches_action(member)))
            for member in running
            if self.may_stop(member)
        ]


class SupervisedNode(Node):
    """A node whose end stops its robot, and which is stopped in its stage.

    Args:
        crew: Nodes of the robot, which this one joins.
        stage: Stage in which the node is stopped, as in `omniman up`.
        essential: Whether the robot is stopped when the node ends.
        is_ours: Whether it is a node of omniman_ros, which follows `PARENT_VARIABLE`. Another one
            gets the Ctrl-C of a terminal directly.
        options: Options of `launch_ros.actions.Node`.
    """

    def __init__(
        self, *, crew: Crew, stage: int, essential: bool, is_ours: bool, **options: Any
    ) -> None:
        if is_ours:
            given = options.get("additional_env", {})
            options["additional_env"] = {**given, PARENT_VARIABLE: str(os.getpid())}
        super().__init__(
            on_exit=self._report_end,
            sigterm_timeout=LaunchConfiguration("sigterm_timeout", default=STOP_TIMEOUT),
            **options,
        )
        self.stage = stage
        self._crew = crew
        self._essential = essential
        self._is_ours = is_ours
        self._respawns = bool(options.get("respawn"))
        self._has_ended = False
        crew.members.append(self)

    @property
    def is_running(self) -> bool:
        """Whether the process was started and has not ended."""
        end = self.get_asyncio_future()
        return end is not None and not end.done() and not self._has_ended

    def _report_end(self, event: ProcessExited, context: LaunchContext) -> Iterable[EmitEvent]:
        """Stop the robot if it needs this node, or stop the next nodes if it is being stopped.

        Raises:
            RuntimeError: The robot is to be stopped, or did not stop in order. To launch, only an
                exception is a failure that its exit code shows.
        """
        text = f"{event.process_name} ended with exit code {event.returncode}"
        if context.is_shutdown:
            self._has_ended = True
            if self._essential and event.returncode not in ENDED_BY_REQUEST:
                self._crew.failures.append(text)
            return self._crew.stop_next()
        if self._essential:
            self._has_ended = True
            raise RuntimeError(f"{text}: stopping the robot")
        self._has_ended = not self._respawns
        more = "it is started again" if self._respawns else "continuing without it"
        get_logger("launch").warning(f"{text}: {more}")
        return ()

    def _shutdown_process(self, context: LaunchContext, *, send_sigint: bool) -> Any:
        """Stop the process once its turn has come.

        launch 3.4 calls this at every shutdown and at the event ShutdownProcess. Later versions
        may not; all nodes are then stopped at once.
        """
        if not self._crew.may_stop(self):
            return None
        return super()._shutdown_process(context, send_sigint=send_sigint or self._is_ours)
