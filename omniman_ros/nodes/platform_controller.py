"""Node `platform_controller`: the only publisher of wheel commands and voltages."""

from collections.abc import Callable
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry as OdometryMsg
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros import conversions
from omniman_ros.core import plausible
from omniman_ros.core.arbiter import Source
from omniman_ros.core.limits import ratio
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import PlatformController
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.wheel_cascade import DriveMode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run
from omniman_ros.nodes.stopping import LATCHED, StopPort

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the wheels on PyPI
    TFMessage = None

SETPOINT = QoSProfile(depth=1)


@dataclass(frozen=True, kw_only=True)
class PlatformControllerParameters:
    """Parameters of the node: those of its core, its rates and frames."""

    platform: PlatformParameters = inline()
    control_rate: float = parameter(
        200.0, "Rate of the control tick.", unit="Hz", low=25, high=1000, read_only=True
    )
    odom_rate: float = parameter(
        100.0, "Rate of odom and /tf, at most the control rate.", unit="Hz", low=1, high=1000,
        read_only=True,
    )  # fmt: skip
    monitor_rate: float = parameter(
        50.0, "Rate of coupling_error, at most the control rate.", unit="Hz", low=1, high=1000,
        read_only=True,
    )  # fmt: skip
    twist_variance: float = parameter(
        1e-4, "Variance of the twist in odom, for those who fuse it.",
        unit="m^2/s^2, rad^2/s^2", low=0, high=100, read_only=True,
    )  # fmt: skip
    odom_frame: str = parameter("odom", "Frame of poses and references.", read_only=True)
    base_frame: str = parameter("base_link", "Frame of twists.", read_only=True)
    map_is_odom: bool = parameter(False, "Whether input in `map` is taken for odom.")
    cmd_vel_stamped: bool = parameter(False, "Whether cmd_vel is a TwistStamped.", read_only=True)
    publish_tf: bool = parameter(True, "Whether odom -> base_link is published on /tf.")


class PlatformControllerNode(OmnimanNode):
    """Message plumbing around `core.platform.PlatformController`."""

    def __init__(self, **options: object) -> None:
        super().__init__("platform_controller", **options)
        self.settings = ParameterSet(self, PlatformControllerParameters)
        p = self.settings.value
        self.core = PlatformController(p.platform)
        self.settings.on_change(lambda new: self.core.configure(new.platform))
        self._names = p.platform.robot.wheels.names
        self._ticks = 0
        self._zero_at = 0
        self._waiting: dict[Source, Callable[[], None]] = {}
        self._active = ""
        self._told: object = None
        self._make_outputs(p)
        self._make_inputs(p)
        self._stop = StopPort(self, self.core.latch, self._reset)
        self._publish_active()
        self._publish_health()
        if TFMessage is None and p.publish_tf:
            self.get_logger().info("no tf2_msgs here: /tf is off, odom has the same pose")
        self.every(1.0 / p.control_rate, self.tick)

    def _make_outputs(self, p: PlatformControllerParameters) -> None:
        self._commands = self.create_publisher(JointState, "wheel_commands", SETPOINT)
        self._voltages = self.create_publisher(JointState, "wheel_voltages", SETPOINT)
        self._odom = self.create_publisher(OdometryMsg, "odom", 10)
        self._tf = self.create_publisher(TFMessage, "/tf", 100) if TFMessage else None
        self._coupling = self.create_publisher(JointState, "coupling_error", 10)
        self._active_source = self.create_publisher(String, "active_source", LATCHED)
        self._health = self.create_publisher(DiagnosticStatus, "wheel_health", LATCHED)
        self._command_msg = JointState(name=list(self._names))
        self._odom_msg = OdometryMsg(child_frame_id=p.base_frame)
        self._odom_msg.header.frame_id = p.odom_frame
        conversions.prepare_odometry(self._odom_msg, p.twist_variance)
        constraints = len(self.core.cascade.coupling.error)
        self._coupling_msg = JointState(name=[f"constraint_{i + 1}" for i in range(constraints)])
        self._odom_every = max(1, round(p.control_rate / p.odom_rate))
        self._monitor_every = max(1, round(p.control_rate / p.monitor_rate))

    def _make_inputs(self, p: PlatformControllerParameters) -> None:
        def subscribe(kind: type, topic: str, handler: object, qos: QoSProfile | int) -> None:
            self.create_subscription(kind, topic, self.guarded(topic, handler), qos)

        subscribe(JointState, "wheel_states", self._on_wheel_states, 5)
        twist = TwistStamped if p.cmd_vel_stamped else Twist
        subscribe(twist, "cmd_vel", self._on_cmd_vel, SETPOINT)
        for source in (Source.MPC, Source.PATH):
            topic = f"{source.value}/reference"
            subscribe(MultiDOFJointTrajectory, topic, self._reference_handler(source), SETPOINT)
        subscribe(JointState, "mpc/voltages", self._on_voltages, SETPOINT)
        subscribe(PoseWithCovarianceStamped, "set_pose", self._on_set_pose, 10)
        self.create_service(Trigger, "~/reset_odometry", self._on_reset_odometry)

    # ---- inputs: each returns why it is not used, or nothing ----------------------------------

    def _on_wheel_states(self, message: JointState) -> str:
        position, velocity, effort = conversions.joint_arrays(message, self._names)
        now = self.now()
        time = now - max(self.age(message.header.stamp), 0.0)
        return self.core.hear_wheels(time, now, position, velocity, effort)

    def _on_cmd_vel(self, message: Twist | TwistStamped) -> str:
        if isinstance(message, Twist):
            return self.core.hear_twist(conversions.twist_array(message), self.now())
        twist = conversions.stamped_twist_array(message, self.settings.value.base_frame)
        return self.core.hear_twist(twist, self.now(), self.age(message.header.stamp))

    def _reference_handler(self, source: Source) -> object:
        def handle(message: MultiDOFJointTrajectory) -> str:
            now = self.now()
            start = now - self.age(message.header.stamp)
            preview = conversions.preview(message, start, self._odom_frames)
            return self.core.hear_preview(source, preview, now)

        handler = self.guarded(f"{source.value}/reference", handle)

        def keep(message: MultiDOFJointTrajectory) -> None:
            """Convert the last one a tick only: a flood of previews must not delay the tick."""
            self._waiting[source] = lambda: handler(message)

        return keep

    def _on_voltages(self, message: JointState) -> str:
        _, _, effort = conversions.joint_arrays(message, self._names)
        volts = conversions.present(effort, plausible.EFFORT, "effort (volts)")
        return self.core.hear_voltages(volts, self.now(), self.age(message.header.stamp))

    def _on_set_pose(self, message: PoseWithCovarianceStamped) -> None:
        self.core.set_pose(*conversions.planar_pose(message, self._odom_frames))

    def _on_reset_odometry(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self.core.set_pose((0.0, 0.0, 0.0))
        response.success = True
        return response

    @property
    def _odom_frames(self) -> tuple[str, ...]:
        p = self.settings.value
        return (p.odom_frame, "map") if p.map_is_odom else (p.odom_frame,)

    def _reset(self) -> None:
        self.core.reset(self.now())

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish a command; odometry and the rest at their own rates."""
        while self._waiting:
            self._waiting.popitem()[1]()
        command = self.core.tick(self.now())
        if command is not None:
            publisher = self._voltages if command.mode is DriveMode.VOLTAGE else self._commands
            conversions.fill_command(self._command_msg, command, self.stamp())
            publisher.publish(self._command_msg)
        if self.core.cancelled:
            self.warn("cancelled", self.core.cancelled)
        self._stop.publish()
        self._publish_active()
        self._publish_health()
        self._ticks += 1
        if self._ticks % self._odom_every == 0 and self.core.feedback.heard:
            self._publish_odom()
        if self._ticks % self._monitor_every == 0:
            self._publish_coupling()

    def _publish_odom(self) -> None:
        odometry, stamp = self.core.odometry, self.stamp(self.core.feedback.time)
        conversions.fill_odometry(
            self._odom_msg, odometry.pose, odometry.twist, odometry.covariance, stamp
        )
        self._odom.publish(self._odom_msg)
        if self._tf is not None and self.settings.value.publish_tf:
            self._tf.publish(TFMessage(transforms=[conversions.transform(self._odom_msg)]))

    def _publish_coupling(self) -> None:
        self._coupling_msg.header.stamp = self.stamp(self.core.feedback.time)
        self._coupling_msg.position = self.core.cascade.coupling.error.tolist()
        self._coupling_msg.velocity = self.core.odometry.constraint_rate.tolist()
        self._coupling.publish(self._coupling_msg)

    def _publish_active(self) -> None:
        source = self.core.arbiter.active
        active = source.value if source else "none" if self.core.latch.released else "stop"
        if active != self._active:
            self._active = active
            self._active_source.publish(String(data=active))

    def _publish_health(self) -> None:
        """Tell on change what is known of each wheel."""
        guard = self.core.guard
        known = (guard.dead, guard.idle, guard.torque_reported)
        if known == self._told:
            return
        self._told = known
        level = DiagnosticStatus.WARN if guard.idle else DiagnosticStatus.OK
        if set(guard.dead) - set(guard.idle):
            level = DiagnosticStatus.ERROR
        values = [(name, guard.state(i)) for i, name in enumerate(self._names)]
        values.append(("torque", "measured" if guard.torque_reported else "not reported"))
        share = self.core.parameters.drive.dead_limits if guard.idle else 1.0
        values.append((conversions.LIMITS_KEY, f"{share:g}"))
        if guard.note:
            self.get_logger().warning(guard.note)
        self._health.publish(
            DiagnosticStatus(
                level=level, name=self.get_fully_qualified_name(),
                message=guard.note or ("a wheel is dead" if guard.dead else "all wheels drive"),
                values=[KeyValue(key=key, value=value) for key, value in values],
            )
        )  # fmt: skip

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        core = self.core
        values: list[tuple[str, object]] = [
            ("active_source", self._active),
            ("wheel_speed_saturated", core.cascade.saturated),
            ("wheels_slipping", core.odometry.slipping),
            ("coupling_error_rad", core.cascade.coupling.error.round(4).tolist()),
            ("tracking_error_m_m_rad", core.tracking_error.round(4).tolist()),
            ("wheel_torque", "measured" if core.guard.torque_reported else
             "not reported: a dead wheel that the floor turns is not noticed"),
            *((name, core.guard.state(i)) for i, name in enumerate(self._names)),
        ]  # fmt: skip
        if not core.latch.released:
            return DiagnosticStatus.ERROR, core.latch.status.reason, values
        if not core.feedback.heard:
            return DiagnosticStatus.WARN, "waiting for wheel_states", values
        for topic in ("wheel_commands", "wheel_voltages", "wheel_states"):
            if self.count_publishers(topic) > 1:
                return DiagnosticStatus.WARN, f"{topic} has more than one publisher", values
        if core.guard.note:
            return DiagnosticStatus.WARN, core.guard.note, values
        if core.odometry.slipping:
            return DiagnosticStatus.WARN, "the wheels slip", values
        return DiagnosticStatus.OK, "running", values

    def begin_shutdown(self, reason: str) -> None:
        """Ramp every wheel to zero; the last commands are zero speeds."""
        self.core.latch.stop(f"shutting down: {reason}")
        self._zero_at = self._ticks + 3

    @property
    def finished(self) -> bool:
        """Whether zero speed has been asked for a few times."""
        if self._ticks == 0:
            return True
        if not self.core.at_rest:
            self._zero_at = self._ticks + 3
        return self.core.at_rest and self._ticks >= self._zero_at

    @property
    def patience(self) -> float:
        """Time of a stop from here [s], and a second."""
        return 1.0 + ratio(self.core.setpoint, self.core.parameters.limits.deceleration)

    @property
    def last_words(self) -> tuple[Publisher, ...]:
        """The wheels' commands: the last ones are zero."""
        return self._commands, self._voltages


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros platform_controller`."""
    return run(PlatformControllerNode, args)
