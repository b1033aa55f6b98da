"""Publishers of the platform controller, and the messages they send."""

from collections.abc import Iterator

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.conversions.motion_limits import motion_demand_message
from omniman_ros.conversions.wheels import LIMIT_SCALE_KEY, POSTURE_SCALE_KEY
from omniman_ros.nodes.arm_configuration import PERIOD, ArmConfigurationInput
from omniman_ros.nodes.message_template import STAMP, MessageTemplate, marks
from omniman_ros.nodes.odometry_interface import imu_fault, imu_values
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import LATCHED

SETPOINT = QoSProfile(depth=1)  #: Quality of service of setpoints: only the latest counts


class ReadyNotice:
    """Logs, once, that a platform controller is ready to drive, and by what."""

    def __init__(self, node: OmnimanNode, core: PlatformController) -> None:
        self._node, self._core = node, core
        self._is_logged = False

    def check(self) -> None:
        """Log it if it is due; call this once a tick."""
        if self._is_logged or not self._core.is_ready(self._node.now()):
            return
        self._is_logged = True
        topic = self._node.resolve_topic_name("cmd_vel")
        kind = "TwistStamped" if self._node.get_parameter("cmd_vel_stamped").value else "Twist"
        self._node.get_logger().info(
            f"ready: drive with {topic} (geometry_msgs/msg/{kind}), as omniman teleop does"
        )


class PlatformOutputs:
    """Publishes what a platform controller commands and reports."""

    def __init__(
        self, node: OmnimanNode, core: PlatformController, posture: ArmConfigurationInput
    ) -> None:
        self._node = node
        self._core = core
        self._posture = posture
        self._names = core.parameters.robot.wheels.names
        self._commands = node.create_publisher(JointState, "wheel_commands", SETPOINT)
        self._voltages = node.create_publisher(JointState, "wheel_voltages", SETPOINT)
        node.final_publishers += [self._commands, self._voltages]  # the last ones are zero
        self._active_source = node.create_publisher(String, "active_source", LATCHED)
        self._health = node.create_publisher(DiagnosticStatus, "wheel_health", LATCHED)
        self._margin = node.create_publisher(Float64, "tip_over_margin", 10)
        node.every(PERIOD, self._publish_margin)
        self._demand = node.create_publisher(JointState, "motion_demand", SETPOINT)
        n = len(self._names)
        self._effort_template = self._command_template(effort=marks(n))
        self._velocity_template = self._command_template(velocity=marks(n), effort=marks(n, n))
        self.active = ""
        self._published_health: object = None

    def _command_template(self, **fields: list[float]) -> MessageTemplate:
        message = JointState(name=list(self._names), **fields)
        message.header.stamp = STAMP
        return MessageTemplate(message)

    def publish_command(self, command: WheelCommand) -> int:
        """Publish a command to the drives: velocity and effort, or effort alone [N m or V].

        Returns:
            Its stamp [ns].
        """
        publisher = self._voltages if command.mode is DriveMode.VOLTAGE else self._commands
        stamp, effort = self._node.ros_time(), command.effort.tolist()
        if command.velocity is None:
            publisher.publish(self._effort_template.pack(stamp, effort))
        else:
            numbers = command.velocity.tolist() + effort
            publisher.publish(self._velocity_template.pack(stamp, numbers))
        return stamp

    def publish_demand(self, frame: str) -> None:
        """Publish the twist that the active source asks for, for a collision monitor in use."""
        if self._core.parameters.collision_monitor.use:
            motion = self._core.demand.tolist()
            self._demand.publish(motion_demand_message((), motion, self._node.stamp(), frame))

    def publish_changes(self) -> None:
        """Publish active source and health of the wheels, where they have changed."""
        self._publish_active_source()
        self._publish_wheel_health()

    def _publish_active_source(self) -> None:
        source = self._core.arbiter.active
        idle = "none" if self._core.latch.released else "stop"
        active = source.value if source else idle
        if active != self.active:
            self.active = active
            self._active_source.publish(String(data=active))

    def _publish_wheel_health(self) -> None:
        """Publish the health of the wheels if it has changed, and log any notice about it."""
        monitor = self._core.wheel_health
        fraction = self._core.stability.fraction
        health = (monitor.dead, monitor.idle, monitor.torque_reported, fraction)
        if health == self._published_health:
            return
        self._published_health = health
        level = DiagnosticStatus.WARN if monitor.idle else DiagnosticStatus.OK
        if monitor.stopping:
            level = DiagnosticStatus.ERROR
        values = [(name, monitor.state(i)) for i, name in enumerate(self._names)]
        values.append(("torque", "measured" if monitor.torque_reported else "not reported"))
        values.append((LIMIT_SCALE_KEY, f"{monitor.limit_scale:g}"))
        values.append((POSTURE_SCALE_KEY, f"{fraction:g}"))
        if monitor.notice and not monitor.stopping:
            self._node.get_logger().warning(monitor.notice)
        self._health.publish(self._node.status_message(level, monitor.summary, values))

    def _publish_margin(self) -> None:
        support, core = self._core.stability.support, self._core
        if support is not None:
            margin = support.margin(core.acceleration, float(core.setpoint[2]))
            self._margin.publish(Float64(data=margin))

    def status(self) -> tuple[bytes, str, Iterator[tuple[str, object]]]:
        """Return level, message and values of the controller for the diagnostics.

        The values are made when they are needed: level and message are compared more often.
        """
        return *self._level(), self._values()

    def _values(self) -> Iterator[tuple[str, object]]:
        core = self._core
        monitor = core.wheel_health
        no_torque = "not reported: a dead wheel that the floor drives goes unnoticed"
        yield from (
            ("active_source", self.active),
            ("wheel_speed_saturated", core.cascade.saturated),
            ("motion_limit", round(core.motion_limit.fraction(self._node.now()), 3)),
            ("wheels_slipping", core.odometry.slipping),
            (
                "slip_not_observable",
                [self._names[i] for i in core.cascade.kinematics.unconstrained],
            ),
            ("coupling_error_rad", core.cascade.coupling.error.round(4).tolist()),
            ("coupling_error_total_rad", core.odometry.coupling_error.round(4).tolist()),
            ("tracking_error_m_m_rad", core.tracking_error.round(4).tolist()),
            ("wheel_torque", "measured" if monitor.torque_reported else no_torque),
            *imu_values(core),
            ("held", core.held),
            ("external_force_N_N_Nm", core.held_robot.observer.external.round(1).tolist()),
            *self._stability_values(),
            *((name, monitor.state(i)) for i, name in enumerate(self._names)),
        )

    def _stability_values(self) -> list[tuple[str, object]]:
        core, support = self._core, self._core.stability.support
        if support is None:
            return []
        acceleration, yaw_rate = core.acceleration, float(core.setpoint[2])
        return [
            ("arm_posture", self._posture.state),
            ("tip_over_margin_m", round(support.margin(acceleration, yaw_rate), 3)),
            ("tip_over_margin_at_rest_m", round(support.rest_margin, 3)),
            ("wheel_loads_N", support.loads(acceleration, yaw_rate).round(0).tolist()),
            (POSTURE_SCALE_KEY, core.stability.fraction),
        ]

    @property
    def _tipping(self) -> str:
        """Return a clause on a robot that is close to tipping over at rest; empty if it is not."""
        support, margin = self._core.stability.support, self._core.parameters.stability.margin
        if support is None or support.rest_margin >= margin:
            return ""
        return f"the tip-over margin at rest is below {margin:g} m"

    def _level(self) -> tuple[bytes, str]:
        core = self._core
        if not core.latch.released:
            return DiagnosticStatus.ERROR, core.latch.status.reason
        if not core.feedback.received:
            return DiagnosticStatus.WARN, "waiting for wheel_states"
        for topic in ("wheel_commands", "wheel_voltages", "wheel_states", "motion_limit"):
            if self._node.count_publishers(topic) > 1:
                return DiagnosticStatus.WARN, f"{topic} has more than one publisher"
        if core.wheel_health.notice:
            return DiagnosticStatus.WARN, core.wheel_health.notice
        is_unlimited = core.motion_limit.is_silent(self._node.now())
        silence = "no fresh motion_limit: does collision_monitor run?" if is_unlimited else ""
        slip = "the wheels slip" if core.odometry.slipping else ""
        doubt = silence or imu_fault(core) or self._tipping or slip
        if doubt:
            return DiagnosticStatus.WARN, doubt
        return DiagnosticStatus.OK, "running"
