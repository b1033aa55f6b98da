"""The motions that a client has sent: where to, and what the nodes report of them."""

from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.publisher import Publisher
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.client.handle import MotionHandle
from omniman_ros.client.shared_node import SharedNode
from omniman_ros.nodes import motion_log
from omniman_ros.nodes.stop_interface import ALL_LATCHED

RECEIPT_TIMEOUT = 5.0  #: Time within which a node must report that it has received a motion [s]


@dataclass(frozen=True)
class MotionTopic:
    """Where motions of one kind are sent to."""

    topic: str
    message: type
    nodes: tuple[str, ...]  #: Names of the nodes of which one takes them
    measured: str = ""  #: Topic that must have been heard before
    hint: str = ""  #: What starts these nodes, where they are no usual ones


_OF_WHOLE_BODY = " (of `omniman up --whole-body-planner`)"
INPUTS = {
    "goal": MotionTopic("goal_pose", PoseStamped, ("mpc_planner",)),
    "path": MotionTopic("path", Path, ("path_interpolator",)),
    "arm": MotionTopic(
        "joint_trajectory", JointTrajectory, ("path_interpolator",), "arm/joint_states"
    ),
    "tool": MotionTopic(
        "tool_path", Path, ("path_interpolator", "whole_body_planner"), "tool_pose"
    ),
    "tool_goal": MotionTopic(
        "tool_goal",
        PoseStamped,
        ("whole_body_planner",),
        "tool_pose",
        _OF_WHOLE_BODY,
    ),
    "joint_goal": MotionTopic(
        "joint_goal",
        JointTrajectory,
        ("whole_body_planner",),
        "arm/joint_states",
        _OF_WHOLE_BODY,
    ),
}  #: Inputs for motions, by their kind


@dataclass
class _Sent:
    handle: MotionHandle
    at: float  # [s]
    #: Identifiers of its node's publishers of events, once the graph has them
    reporters: frozenset[bytes] = frozenset()


class SentMotions:
    """Sends motions, and tells their handles what becomes of them."""

    def __init__(self, shared: SharedNode) -> None:
        self._shared = shared
        self._sent: dict[str, _Sent] = {}
        self._publishers: dict[str, Publisher] = {
            kind: shared.publisher(to.message, to.topic, 10) for kind, to in INPUTS.items()
        }
        self._cancels = {
            name: shared.client(f"{name}/cancel")
            for name in sorted({name for to in INPUTS.values() for name in to.nodes})
        }
        shared.subscribe(DiagnosticStatus, motion_log.TOPIC, self._on_event, ALL_LATCHED)
        shared.subscribe(DiagnosticStatus, "mpc/status", self._on_planner, 10)
        shared.subscribe(Float64, "path_progress", self._on_progress, 10)

    def can_send(self, kind: str) -> bool:
        """Return whether a node is there that takes motions of a kind, and can cancel them."""
        is_taken = self._publishers[kind].get_subscription_count() > 0
        return is_taken and any(self._cancels[n].service_is_ready() for n in INPUTS[kind].nodes)

    def send(self, handle: MotionHandle, message: Any) -> None:
        """Send a motion, whose stamp is one of its own."""
        stamp = message.header.stamp
        request = f"{stamp.sec}.{stamp.nanosec:09d}"  # as `motion_events` names it
        self._sent[request] = _Sent(handle, self._shared.now())
        self._publishers[handle.kind].publish(message)

    @property
    def running(self) -> list[MotionHandle]:
        """The motions that have not ended."""
        return [sent.handle for sent in self._sent.values() if sent.handle.outcome is None]

    def request_cancel(self, handle: MotionHandle) -> None:
        """Ask the node that drives a motion to cancel it, without waiting."""
        nodes = INPUTS[handle.kind].nodes
        if handle.node:
            nodes = (handle.node.rpartition("/")[2],)
        for name in nodes:
            client = self._cancels[name]
            if len(nodes) == 1 or client.service_is_ready():
                future = client.call_async(Trigger.Request())
                future.add_done_callback(lambda done: self._take_answer(handle, done.result()))

    def _take_answer(self, handle: MotionHandle, answer: Any) -> None:
        with self._shared.lock:
            handle.answer_cancel(answer.success, answer.message)
            self._shared.lock.notify_all()

    def _on_event(self, message: DiagnosticStatus) -> None:
        values = {item.key: item.value for item in message.values}
        sent = self._sent.get(values.get("request", ""))
        if sent is None or sent.handle.outcome is not None:
            return
        sent.handle.report(message.name, values.get("event", ""), message.message)

    def _on_planner(self, message: DiagnosticStatus) -> None:
        values = {item.key: item.value for item in message.values}
        for handle in self.running if "distance_m" in values else ():
            if handle.kind == "goal":
                handle.approach(float(values["distance_m"]))

    def _on_progress(self, message: Float64) -> None:
        for handle in self.running:
            if handle.kind != "goal":
                handle.advance(message.data)

    def _reporters(self, node: str) -> frozenset[bytes]:
        """Return the identifiers of a node's publishers of events in the graph."""
        topic = self._shared.name(motion_log.TOPIC)
        return frozenset(
            bytes(info.endpoint_gid)
            for info in self._shared.node.get_publishers_info_by_topic(topic)
            if f"{info.node_namespace.rstrip('/')}/{info.node_name}" == node
        )

    def watch(self) -> None:
        """End the motions of which nobody will report the end; forget those that have ended.

        A node that was killed stays in the graph for 20 s. One that was started anew in its place
        knows nothing of the motion, so that names do not tell.
        """
        for request, sent in list(self._sent.items()):
            handle, is_late = sent.handle, self._shared.now() - sent.at > RECEIPT_TIMEOUT
            if handle.outcome is not None:
                del self._sent[request]
                continue
            # A node's messages may come before the graph has its name.
            reporters = self._reporters(handle.node) if handle.node else frozenset()
            sent.reporters = sent.reporters or reporters
            if (sent.reporters or is_late) and not sent.reporters & reporters:
                why = f"{handle.node} has ended" if handle.node else "no node has reported it"
                self.request_cancel(handle)  # somebody may drive it nevertheless
                handle.lose(why)
