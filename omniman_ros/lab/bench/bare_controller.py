"""Baseline of the nodes' cost: a plain rclpy node with the topics of `platform_controller`.

It has messages of the same kinds and rates in and out, the same executor and services, but no
parameters, no checks and no control: it publishes messages that are filled once, with a new
stamp. What it costs is what rclpy and the middleware cost.
"""

import sys

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

RATE = 200.0
"""Rate of the wheel commands [Hz]."""
EVERY = {"odom": 2, "coupling_error": 4, "tip_over_margin": 8, "/diagnostics": 200}
"""Number of ticks from one message to the next, by topic."""
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""Names of the wheels in the commands."""
SETPOINT = QoSProfile(depth=1)
"""Quality of service of topics of which only the last message counts."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service of topics whose last message reaches late subscribers."""
SPIN_TIME = 0.05
"""Time for which callbacks are served at once [s]: without a limit, EventsExecutor hangs."""


class BareController(Node):
    """Publishes the same messages as `platform_controller`, at the same rates."""

    def __init__(self) -> None:
        super().__init__("bare_controller")
        zeros = [0.0] * len(WHEELS)
        self._command = JointState(name=list(WHEELS), velocity=zeros, effort=zeros)
        self._commands = self.create_publisher(JointState, "wheel_commands", SETPOINT)
        self._others = [
            (EVERY[topic], message, self.create_publisher(type(message), topic, 10))
            for topic, message in (
                ("odom", Odometry()),
                ("coupling_error", JointState(name=["c"], position=[0.0], velocity=[0.0])),
                ("tip_over_margin", Float64()),
                ("/diagnostics", DiagnosticArray(status=[DiagnosticStatus()])),
            )
        ]
        self._latched = [
            self.create_publisher(kind, topic, LATCHED)
            for kind, topic in (
                (String, "active_source"),
                (DiagnosticStatus, "wheel_health"),
                (DiagnosticStatus, "stop_state"),
            )
        ]
        for topic in ("wheel_voltages", "motion_demand"):
            self.create_publisher(JointState, topic, SETPOINT)
        self._subscribe()
        for name in ("stop", "reset", "reset_odometry"):
            self.create_service(Trigger, f"~/{name}", lambda request, response: response)
        self._latched[-1].publish(DiagnosticStatus())
        self._ticks = 0
        self.create_timer(1.0 / RATE, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _subscribe(self) -> None:
        for kind, topic, depth in (
            (Twist, "cmd_vel", 1),
            (MultiDOFJointTrajectory, "path/reference", 1),
            (MultiDOFJointTrajectory, "mpc/reference", 1),
            (JointState, "mpc/voltages", 1),
            (JointState, "motion_limit", 1),
            (JointState, "wheel_states", 5),
            (PoseWithCovarianceStamped, "set_pose", 10),
            (Bool, "emergency_stop", 10),
            (DiagnosticStatus, "stop_state", 50),
        ):
            self.create_subscription(kind, topic, self._keep, depth)
        self.create_subscription(JointState, "arm/joint_states", self._keep, SETPOINT, raw=True)

    def _keep(self, message: object) -> None:
        self._last = message

    def _tick(self) -> None:
        self._ticks += 1
        now = self.get_clock().now().to_msg()
        self._command.header.stamp = now
        self._commands.publish(self._command)
        for every, message, publisher in self._others:
            if self._ticks % every == 0:
                if not isinstance(message, Float64):
                    message.header.stamp = now
                publisher.publish(message)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is shut down; return its exit code."""
    rclpy.init(args=args)
    node = BareController()
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_until_future_complete(rclpy.Future(), timeout_sec=SPIN_TIME)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
