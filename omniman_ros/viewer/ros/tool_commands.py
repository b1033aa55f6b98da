"""Paths of the tool that are led by hand on the page."""

from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from omniman_ros.conversions.headers import check_frame
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.viewer.events import ToolHandleMoved
from omniman_ros.viewer.ros.lazy_subscriptions import LazySubscriptions
from omniman_ros.viewer.ros.parameters import ViewerParameters
from omniman_ros.viewer.tool_goal import ToolPose
from omniman_ros.viewer.view_state import ViewState


class ToolCommands:
    """Receives where the tool is, and sends the path to the handle.

    Attributes:
        actions: What the buttons of the page do, by action.
    """

    def __init__(
        self,
        node: OmnimanNode,
        subscriptions: LazySubscriptions,
        parameters: ViewerParameters,
        state: ViewState,
    ) -> None:
        self._node, self._state = node, state
        self._frames, self._odom_frame = parameters.frames, parameters.odom_frame
        self._goal = state.tool_goal
        self._paths = node.create_publisher(Path, "tool_path", 10)
        subscriptions.subscribe_while_watched(PoseStamped, "tool_pose", self._on_tool)
        self.actions: dict[str, Callable[[float], None]] = {
            "tool_place": self._place,
            "tool_add": lambda now: self._goal.add(),
            "tool_send": self._send,
            "tool_remove": lambda now: self._goal.remove(),
        }

    def move(self, event: ToolHandleMoved, now: float) -> None:
        """Move the handle."""
        self._goal.move(ToolPose.checked(event.position, event.rotation))

    def _on_tool(self, message: PoseStamped) -> None:
        check_frame(message.header.frame_id, *self._frames)
        p, q = message.pose.position, message.pose.orientation
        pose = ToolPose.checked((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))
        self._state.update_tool(pose, self._node.now())

    def _place(self, now: float) -> None:
        tool = self._state.tool
        if tool is None or not self._state.is_fresh("tool", now):
            raise InputError("it is not known where the tool is: nothing is received on tool_pose")
        self._goal.place(tool)

    def _send(self, now: float) -> None:
        path = Path()
        path.header.stamp, path.header.frame_id = self._node.stamp(), self._odom_frame
        for each in self._goal.path:
            pose = PoseStamped(header=path.header)
            p, q = pose.pose.position, pose.pose.orientation
            p.x, p.y, p.z = each.position
            q.w, q.x, q.y, q.z = each.rotation
            path.poses.append(pose)
        self._paths.publish(path)
        count = len(path.poses)
        nobody = "" if self._state.path_states else "; no node reports that takes it"
        self._state.note = f"path of the tool sent, poses: {count}{nobody}"
        self._goal.poses = ()
        self._state.tool_reports = 0
