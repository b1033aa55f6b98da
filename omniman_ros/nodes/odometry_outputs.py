"""What the odometry publishes: `odom`, `coupling_error` and transforms."""

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import JointState

from omniman_ros.conversions.coupling import coupling_error_numbers, coupling_names
from omniman_ros.conversions.odometry import (
    ODOMETRY_NUMBERS,
    initialize_odometry,
    odometry_numbers,
    odometry_transform,
    set_odometry_numbers,
)
from omniman_ros.nodes import tf_messages
from omniman_ros.nodes.message_template import STAMP, MessageTemplate, marks
from omniman_ros.nodes.odometry_interface import OdometryCore, Settings
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.static_transforms import StaticTransforms


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
