"""What the browsers ask for: events of the page, carried out one after another."""

from collections.abc import Callable

from omniman_ros.core.errors import InputError
from omniman_ros.viewer import events
from omniman_ros.viewer.hold_to_drive import HoldToDrive
from omniman_ros.viewer.ros.obstacle_interface import ObstaclePublisher
from omniman_ros.viewer.ros.planner_parameters import PlannerParameterClient
from omniman_ros.viewer.ros.pose_commands import PoseCommands
from omniman_ros.viewer.ros.service_calls import ServiceCalls
from omniman_ros.viewer.ros.tool_commands import ToolCommands
from omniman_ros.viewer.tour import Handler, Tour
from omniman_ros.viewer.view_state import ViewState


class PageCommands:
    """Takes the events of the page from its threads, and has the right part carry each out."""

    def __init__(
        self,
        state: ViewState,
        buttons: HoldToDrive,
        poses: PoseCommands,
        obstacles: ObstaclePublisher,
        planner_parameters: PlannerParameterClient,
        calls: ServiceCalls,
        tool: ToolCommands,
    ) -> None:
        self._state, self._buttons, self._poses, self._calls = state, buttons, poses, calls
        self._queue = events.EventQueue()
        self.tour = Tour()  #: The tour, which follows what is done on the page
        handlers: dict[type, Handler] = {
            events.ButtonHeld: buttons.update,
            events.ButtonReleased: buttons.update,
            events.ClientDisconnected: buttons.update,
            events.ButtonPressed: self._press,
            events.GoalDragged: poses.drag_goal,
            events.StartDragged: poses.drag_start,
            events.CaseSelected: poses.load,
            events.ParameterChanged: planner_parameters.set,
            events.ToolHandleMoved: tool.move,
            **obstacles.handlers,
        }
        self._handlers = self.tour.following(handlers)
        self._actions: dict[str, Callable[[float], None]] = {
            events.STOP: lambda now: self._stop_or_reset(events.STOP, now),
            "reset": lambda now: self._stop_or_reset("reset", now),
            "pause": poses.pause,
            "resume": poses.resume,
            "cancel": poses.cancel,
            "go": poses.go,
            "restart": poses.restart,
            "add": obstacles.add,
            "clear": lambda now: state.clear_trails(),
            "tour": lambda now: self.tour.toggle(),
            **tool.actions,
        }

    def post(self, event: events.Event) -> None:
        """Take an event of the page; may be called from any thread."""
        self._queue.post(event)

    def carry_out(self, now: float) -> None:
        """Carry out the events that wait, at a time [s]; what is refused is noted on the page."""
        for error in self._queue.process(self._handlers, now):
            self._state.note = str(error)

    def close(self) -> None:
        """Take no more events."""
        self._queue.close()

    def _press(self, event: events.ButtonPressed, now: float) -> None:
        if event.action not in self._actions:
            raise InputError(f"there is no button '{event.action[:40]}'")
        self._actions[event.action](now)

    def _stop_or_reset(self, action: str, now: float) -> None:
        self._buttons.release_all()
        self._poses.abort()
        self._calls.stop_or_reset(action, now)
