"""Process on a host that publishes what its input says and prints what it receives.

Each line is a JSON array. Input: `["twist", x]` publishes a twist at 20 Hz from now on,
`["silent"]` ends that, `["goal", x, y]` and `["emergency", true]` are published once. Output:
`["truth", time, speed, x]`, `["state", node, text]` and `["source", name]`, with the time of the
steady clock [s].
"""

import json
import math
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool, String

from omniman_ros.console.session import Session
from omniman_ros.nodes.rclpy_compat import subscribe_with_source_time
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED

PERIOD = 0.05  #: Period of the twists [s]


class Observer:
    """Publishes and prints."""

    def __init__(self, session: Session) -> None:
        node = session.node
        self._twist: Twist | None = None
        self._source_sent = 0
        self._twists = node.create_publisher(Twist, "cmd_vel", 1)
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        self._buttons = node.create_publisher(Bool, "emergency_stop", LATCHED)
        node.create_subscription(Odometry, "ground_truth/odom", self._on_truth, 10)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_state, ALL_LATCHED)
        subscribe_with_source_time(node, String, "active_source", self._on_source, LATCHED)
        node.create_timer(PERIOD, self._publish_twist)

    def obey(self, word: str, *values: float) -> None:
        """Publish what a line of the input says."""
        if word == "twist":
            twist = Twist()
            twist.linear.x = float(values[0])
            self._twist = twist
        elif word == "silent":
            self._twist = None
        elif word == "goal":
            goal = PoseStamped()
            goal.header.frame_id = "odom"
            goal.pose.position.x, goal.pose.position.y = map(float, values)
            self._goals.publish(goal)
        else:
            self._buttons.publish(Bool(data=bool(values[0])))

    def _publish_twist(self) -> None:
        if self._twist is not None:
            self._twists.publish(self._twist)

    def _on_truth(self, message: Odometry) -> None:
        twist = message.twist.twist
        speed = math.hypot(twist.linear.x, twist.linear.y) + 0.3 * abs(twist.angular.z)
        _say("truth", time.monotonic(), speed, message.pose.pose.position.x)

    def _on_state(self, message: DiagnosticStatus) -> None:
        _say("state", message.name, message.message)

    def _on_source(self, message: String, sent: int) -> None:
        if sent > self._source_sent:  # a latched message may be delivered a second time
            self._source_sent = sent
            _say("source", message.data)


def _say(*words: object) -> None:
    sys.stdout.write(json.dumps(words) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Run until the input ends."""
    lines: list[str] = []

    def read() -> None:
        for line in sys.stdin:
            lines.append(line)
        lines.append("")

    threading.Thread(target=read, daemon=True).start()
    with Session("observer") as session:
        observer = Observer(session)
        while True:
            while lines:
                line = lines.pop(0)
                if not line:
                    return
                observer.obey(*json.loads(line))
            session.spin(0.01)


if __name__ == "__main__":
    main()
