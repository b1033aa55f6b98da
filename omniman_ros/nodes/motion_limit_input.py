"""Topic from which a node knows the limit of the speed before contact."""

from collections.abc import Callable

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.conversions.motion_limits import motion_limit_fractions
from omniman_ros.core.motion_limit import MotionLimit
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Quality of service: with a queue of one message, that of another publisher would replace the
#: limit before it is read.
QUEUE = QoSProfile(depth=10)


def subscribe_to_motion_limit(
    node: OmnimanNode,
    *,
    platform: MotionLimit | None = None,
    arm: MotionLimit | None = None,
    on_update: Callable[[], None] = lambda: None,
) -> None:
    """Update limits from `motion_limit`; `on_update` is called after each valid message."""

    def receive(message: JointState) -> None:
        sent, now = node.instant(message.header.stamp), node.now()
        publishers = subscription.get_publisher_count()
        for limit, fraction in zip((platform, arm), motion_limit_fractions(message), strict=True):
            if limit is not None:
                limit.update(fraction, sent, now, publishers)
        on_update()

    handler = node.guarded("motion_limit", receive)
    subscription = node.create_subscription(JointState, "motion_limit", handler, QUEUE)
