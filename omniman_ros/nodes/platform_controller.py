"""Node `platform_controller`: the only publisher of wheel commands and voltages."""

from collections.abc import Callable, Iterable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.control.limits import ratio
from omniman_ros.control.platform import PlatformController
from omniman_ros.conversions.geometry import stamped_twist_array, twist_array
from omniman_ros.conversions.headers import is_stamped
from omniman_ros.conversions.joints import joint_arrays, require_array
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.core import plausible
from omniman_ros.core.arbiter import PREVIEW_SOURCES, Source
from omniman_ros.core.arrays import Array
from omniman_ros.description.arm_mass import ArmMass
from omniman_ros.nodes.arm_configuration import ArmConfigurationInput
from omniman_ros.nodes.journal_output import JournalOutput
from omniman_ros.nodes.motion_limit_input import subscribe_to_motion_limit
from omniman_ros.nodes.odometry_interface import OdometryInputs, OdometryOutputs
from omniman_ros.nodes.odometry_parameters import OdometryTopicParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.platform_controller_parameters import PlatformControllerParameters
from omniman_ros.nodes.platform_outputs import SETPOINT, PlatformOutputs, ReadyNotice
from omniman_ros.nodes.rclpy_compat import subscribe_with_source_time
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stop_interface import StopInterface

DEMAND_RATE = 50.0  #: Rate of `motion_demand`, as near as whole numbers of ticks allow [Hz]
FINAL_ZEROS = 3  #: Number of zero setpoints that the drives get before the node ends


class PlatformControllerNode(OmnimanNode):
    """Connects a platform controller to its topics."""

    lookahead = 0.01

    def __init__(self, **options: Any) -> None:
        super().__init__("platform_controller", **options)
        self.settings = ParameterSet(self, PlatformControllerParameters)
        p = self.settings.value
        self.core = PlatformController(p.platform)
        self._arm_mass = ArmMass(p.platform.robot.arm, p.mount)
        self.settings.on_change(self._configure)
        self._names = p.platform.robot.wheels.names
        self._ticks = 0
        self._finish_tick = 0
        self._waiting: dict[Source, Callable[[], None]] = {}
        self._odom_every = max(1, round(p.control_rate / p.topics.odom_rate))
        self._monitor_every = max(1, round(p.control_rate / p.topics.monitor_rate))
        self._demand_every = max(1, round(p.control_rate / DEMAND_RATE))
        self._posture = ArmConfigurationInput(self, p.arm.joints, self._on_arm_configuration)
        self._outputs = PlatformOutputs(self, self.core, self._posture)
        self._journal = JournalOutput(self, self.core)
        self._odometry = OdometryOutputs(self, self.core, self._topics) if p.publish_odom else None
        self._odometry_inputs = OdometryInputs(self, self.core, self._names, self._topics)
        self._make_inputs(p)
        self._ready_notice = ReadyNotice(self, self.core)
        self._stop = StopInterface(self, self.core.latch, self._reset)
        self._outputs.publish_changes()
        self.every(1.0 / p.control_rate, self.tick)

    def _configure(self, new: PlatformControllerParameters) -> None:
        self.core.configure(new.platform)
        self._arm_mass = ArmMass(new.platform.robot.arm, new.mount)
        self._posture.repeat()

    def _make_inputs(self, p: PlatformControllerParameters) -> None:
        def subscribe(
            kind: type, topic: str, handler: Callable[[Any], str | None], qos: QoSProfile | int
        ) -> None:
            self.create_subscription(kind, topic, self.guarded(topic, handler), qos)

        twist = TwistStamped if p.cmd_vel_stamped else Twist
        self.foreign_types.selectors["cmd_vel"] = "cmd_vel_stamped"
        on_cmd_vel = self.guarded("cmd_vel", self._on_cmd_vel)
        subscribe_with_source_time(self, twist, "cmd_vel", on_cmd_vel, SETPOINT)
        for source in PREVIEW_SOURCES:
            topic = f"{source.value}/reference"
            handler = self._reference_handler(source)
            self.create_subscription(MultiDOFJointTrajectory, topic, handler, SETPOINT)
        subscribe(JointState, "mpc/voltages", self._on_voltages, SETPOINT)
        subscribe_to_motion_limit(self, platform=self.core.motion_limit)

    def _on_cmd_vel(self, message: Twist | TwistStamped, source_time: int) -> str:
        sent = self.sent(source_time)
        if isinstance(message, Twist):
            return self.core.set_twist(twist_array(message), self.now(), sent=sent)
        twist = stamped_twist_array(message, self._topics().base_frame)
        return self.core.set_twist(twist, self.now(), self._stated_age(message), sent)

    def _reference_handler(self, source: Source) -> Callable[[MultiDOFJointTrajectory], None]:
        """Return a callback that keeps the last preview of a source for the next tick.

        Only the last one of a tick is converted: a flood of previews must not delay the tick.
        """

        def handle(message: MultiDOFJointTrajectory) -> str:
            start = self.instant(message.header.stamp)
            preview = preview_from_message(message, start, self._topics().frame.names)
            return self.core.set_preview(
                source, preview, self.now(), is_stamped(message.header.stamp)
            )

        handler = self.guarded(f"{source.value}/reference", handle)

        def keep(message: MultiDOFJointTrajectory) -> None:
            self._waiting[source] = lambda: handler(message)

        return keep

    def _on_arm_configuration(self, posture: Array) -> None:
        if self.core.parameters.robot.arm.mass > 0.0:
            self.core.set_arm(self._arm_mass.at(posture))

    def _on_voltages(self, message: JointState) -> str:
        _, _, effort = joint_arrays(message, self._names)
        volts = require_array(effort, plausible.EFFORT, "effort (volts)")
        return self.core.set_voltages(volts, self.now(), self._stated_age(message))

    def _stated_age(self, message: TwistStamped | JointState) -> float | None:
        """Return the age of a message by its stamp [s]; None for a zero stamp."""
        stamp = message.header.stamp
        return self.age(stamp) if is_stamped(stamp) else None

    def _topics(self) -> OdometryTopicParameters:
        return self.settings.value.topics

    def _reset(self) -> None:
        self.core.reset(self.now())

    def tick(self) -> None:
        """Publish a command, and odometry and the coupling error at their own rates."""
        while self._waiting:
            self._waiting.popitem()[1]()
        command = self.core.tick(self.now())
        if command is not None:
            self._journal.note_published(self._outputs.publish_command(command))
        if self.core.cancelled:
            self.warn("cancelled", self.core.cancelled)
        self._stop.publish()
        self._outputs.publish_changes()
        self._ready_notice.check()
        self._ticks += 1
        if self._ticks % self._demand_every == 0:
            self._outputs.publish_demand(self._topics().base_frame)
        if self._odometry is not None:
            self._publish_odometry(self._odometry)
        self._journal.after_tick(at_once=self._finish_tick > 0)

    def _publish_odometry(self, outputs: OdometryOutputs) -> None:
        feedback = self.core.feedback
        if self._ticks % self._odom_every == 0 and feedback.received:
            outputs.publish_odometry(self.ros_time(feedback.time))
        if self._ticks % self._monitor_every == 0:
            outputs.publish_coupling_error(self.ros_time(feedback.time))

    def status(self) -> tuple[bytes, str, Iterable[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        return self._outputs.status()

    def begin_shutdown(self, reason: str) -> None:
        """Ramp every wheel to zero; the last commands are zero speeds."""
        self.core.latch.shut_down(reason)
        self._finish_tick = self._ticks + FINAL_ZEROS

    @property
    def finished(self) -> bool:
        """Whether the drives have received their zero setpoints."""
        if self._ticks == 0:
            return True
        if not self.core.at_rest:
            self._finish_tick = self._ticks + FINAL_ZEROS
        return self.core.at_rest and self._ticks >= self._finish_tick

    @property
    def stop_timeout(self) -> float:
        """How long the platform may take to come to rest from now on [s], with a margin of 1 s."""
        return 1.0 + ratio(self.core.setpoint, self.core.limits.deceleration)


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros platform_controller`."""
    return run(PlatformControllerNode, args)
