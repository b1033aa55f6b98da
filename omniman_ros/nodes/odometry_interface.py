"""What the odometry subscribes to and publishes, in `platform_controller` and in `odometry`."""

from collections.abc import Callable, Sequence
from typing import Protocol

from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry as OdometryMsg
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import UInt32MultiArray
from std_srvs.srv import Trigger

from omniman_ros.control.imu import ImuFeedback
from omniman_ros.control.odometry import Odometry
from omniman_ros.control.wheel_feedback import WheelFeedback
from omniman_ros.conversions.coupling import coupling_error_numbers, coupling_names
from omniman_ros.conversions.headers import SerializedStamp
from omniman_ros.conversions.imu import imu_arrays
from omniman_ros.conversions.odometry import (
    ODOMETRY_NUMBERS,
    initialize_odometry,
    odometry_numbers,
    odometry_transform,
    set_odometry_numbers,
)
from omniman_ros.conversions.poses import planar_pose
from omniman_ros.conversions.wheels import restarts_of_message
from omniman_ros.core.arrays import Array
from omniman_ros.nodes import tf_messages
from omniman_ros.nodes.joint_state_reader import JointStateReader
from omniman_ros.nodes.message_template import STAMP, MessageTemplate, marks
from omniman_ros.nodes.odometry_parameters import OdometryTopicParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.static_transforms import StaticTransforms
from omniman_ros.nodes.stop_interface import LATCHED

Settings = Callable[[], OdometryTopicParameters]  #: Returns the present parameters of the topics


class OdometryCore(Protocol):
    """A core that computes odometry from the reports of the wheels."""

    odometry: Odometry  #: Pose, twist and covariance
    feedback: WheelFeedback  #: Last feedback of the wheels
    imu: ImuFeedback  #: Measurements of an inertial sensor

    @property
    def coupling_error(self) -> Array:
        """Coupling error epsilon (m,) since the last rest of the wheels [rad]."""

    def update_wheels(
        self,
        time: float,
        now: float,
        position: Array | None,
        velocity: Array | None,
        effort: Array | None = None,
    ) -> str:
        """Process the state of the wheels; return a warning to log, or an empty string."""

    def set_pose(self, pose: tuple[float, float, float], covariance: Array | None = None) -> None:
        """Set the pose and its covariance; None means zero."""

    def reset_odometry(self) -> None:
        """Set the pose to the origin, and the coupling error without resets to zero."""


def imu_fault(core: OdometryCore) -> str:
    """Return why the heading is that of the wheels alone though `imu.use` is set; else empty."""
    fault = core.imu.fault if core.imu.parameters.use else ""
    return f"{fault}: the heading is that of the wheels" if fault else ""


def imu_values(core: OdometryCore) -> list[tuple[str, object]]:
    """Return values about the inertial sensor for the diagnostics."""
    state = (core.imu.fault or "used") if core.imu.parameters.use else "not used"
    return [("imu", state), ("yaw_bias_rad_s", round(core.odometry.yaw_bias, 5))]


class OdometryInputs:
    """Subscribes to the wheels' topics, `set_pose` and, with `imu.use`, `imu`; serves a reset."""

    def __init__(
        self,
        node: OmnimanNode,
        core: OdometryCore,
        names: Sequence[str],
        settings: Settings,
        on_report: Callable[[SerializedStamp], None] | None = None,
    ) -> None:
        self._node = node
        self._core = core
        self._reader, self._count = JointStateReader(names), len(names)
        self._settings = settings
        self._on_report = on_report
        self._restarts: tuple[int, ...] | None = None
        on_restarts = node.guarded("wheel_restarts", self._on_restarts)
        node.create_subscription(UInt32MultiArray, "wheel_restarts", on_restarts, LATCHED)
        on_states = node.guarded("wheel_states", self._on_wheel_states)
        node.create_subscription(JointState, "wheel_states", on_states, 5, raw=True)
        on_pose = node.guarded("set_pose", self._on_set_pose)
        node.create_subscription(PoseWithCovarianceStamped, "set_pose", on_pose, 10)
        if core.imu.parameters.use:
            on_imu = node.guarded("imu", self._on_imu)
            # Sensors may be published with best effort, which a reliable subscription refuses.
            node.create_subscription(Imu, "imu", on_imu, qos_profile_sensor_data)
        node.create_service(Trigger, "~/reset_odometry", self._on_reset)

    def _on_wheel_states(self, data: bytes) -> None:
        stamp, position, velocity, effort = self._reader.read(data)
        now = self._node.now()
        time = self._node.instant(stamp)
        warning = self._core.update_wheels(time, now, position, velocity, effort)
        if self._on_report is not None:
            self._on_report(stamp)
        if warning:  # of a report that is used
            self._node.warn("wheel_states: motion", warning)

    def _on_restarts(self, message: UInt32MultiArray) -> None:
        known, self._restarts = self._restarts, restarts_of_message(message, self._count)
        if known not in (None, self._restarts):
            self._core.feedback.note_restart()

    def _on_imu(self, message: Imu) -> None:
        rate, acceleration = imu_arrays(message, self._core.imu.parameters.mount.frame)
        now = self._node.now()
        time = self._node.instant(message.header.stamp)
        self._core.imu.update(time, now, rate, acceleration)

    def _on_set_pose(self, message: PoseWithCovarianceStamped) -> None:
        self._node.demand_not_ahead(message.header.stamp)
        self._core.set_pose(*planar_pose(message, self._settings().frame.names))

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._core.reset_odometry()
        response.success = True
        return response


class OdometryOutputs:
    """Publishes `odom`, `coupling_error` and, on `/tf` and `/tf_static`, transforms."""

    def __init__(self, node: OmnimanNode, core: OdometryCore, settings: Settings) -> None:
        self._core = core
        self._settings = settings
        self._odom = node.create_publisher(OdometryMsg, "odom", 10)
        self._tf = None
        if tf_messages.TFMessage is not None:
            self._tf = node.create_publisher(tf_messages.TFMessage, tf_messages.TOPIC, 100)
        self._coupling = node.create_publisher(JointState, "coupling_error", 10)
        p = settings()
        message = OdometryMsg(child_frame_id=p.base_frame)
        message.header.frame_id, message.header.stamp = p.frame.odom_frame, STAMP
        initialize_odometry(message, p.twist_variance)
        set_odometry_numbers(message, marks(ODOMETRY_NUMBERS))
        self._odom_template = MessageTemplate(message)
        if tf_messages.TFMessage is not None:
            transforms = tf_messages.TFMessage(transforms=[odometry_transform(message)])
            self._tf_template = MessageTemplate(transforms)
        names = coupling_names(len(core.coupling_error))
        n = len(names)
        coupling = JointState(name=names, position=marks(n), velocity=marks(n, n))
        coupling.header.stamp = STAMP
        self._coupling_template = MessageTemplate(coupling)
        if self._tf is None and p.publish_tf:
            node.get_logger().info("tf2_msgs is not installed: /tf is off, odom has the same pose")

        if p.frame.map_is_odom and p.publish_tf:
            self._publish_map(node, p.frame.odom_frame)

    @staticmethod
    def _publish_map(node: OmnimanNode, odom_frame: str) -> None:
        """Publish that `map` and odom are one, for what knows only `map`."""
        same = TransformStamped(child_frame_id=odom_frame)
        same.header.frame_id, same.header.stamp = "map", node.stamp()
        StaticTransforms(node, "map_is_odom and odom").publish([same])

    def publish_odometry(self, stamp: int) -> None:
        """Publish the odometry at a ROS time [ns] and, with `publish_tf`, its transform."""
        odometry = self._core.odometry
        numbers = odometry_numbers(odometry.pose, odometry.twist, odometry.covariance)
        self._odom.publish(self._odom_template.pack(stamp, numbers))
        if self._tf is not None and self._settings().publish_tf:
            self._tf.publish(self._tf_template.pack(stamp, numbers))

    def publish_coupling_error(self, stamp: int) -> None:
        """Publish the coupling errors, since the last rest and without resets, and their rate."""
        odometry = self._core.odometry
        numbers = coupling_error_numbers(
            self._core.coupling_error, odometry.coupling_error, odometry.constraint_rate
        )
        self._coupling.publish(self._coupling_template.pack(stamp, numbers))
