"""Topic on which a simulated robot is put somewhere."""

from collections.abc import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import Header

from omniman_ros.conversions.poses import planar_pose
from omniman_ros.core.rigid import PlanarPose, Transform
from omniman_ros.core.transform_tree import NotConnectedError, UnknownFrameError
from omniman_ros.nodes.frame_parameters import FrameParameters, OdomFrame, TransformOptions
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode


class InitialPoseInput:
    """Subscribes to `initialpose`, the pose at which a simulated robot is to be.

    It may be in any frame that TF relates to that of the simulated world, and is transformed at
    its stamp. As long as TF relates neither of them to that frame, `map` and odom count as it.

    Args:
        place: Puts the robot at a pose (x, y, theta) in the world [m, m, rad], or raises an
            InputError.
    """

    def __init__(
        self,
        node: OmnimanNode,
        world_frame: str,
        odom_frame: str,
        place: Callable[[PlanarPose], None],
    ) -> None:
        self._names = (world_frame, "map", odom_frame)
        self._place = place
        # The transforms end in the world here, where the robot is, and not in odom.
        frames = FrameParameters(odom=OdomFrame(odom_frame=world_frame), tf=TransformOptions())
        self._frames = FrameTransforms(node, lambda: frames)
        handler = self._frames.deferred(
            "initialpose", lambda message: [message.header], self._on_pose
        )
        node.create_subscription(
            PoseWithCovarianceStamped, "initialpose", node.guarded("initialpose", handler), 10
        )

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose, _ = planar_pose(message, (message.header.frame_id.lstrip("/"),))
        into_world = self._into_world(message.header)
        self._place((into_world @ Transform.of_planar(pose)).planar())

    def _into_world(self, header: Header) -> Transform:
        try:
            return self._frames.into_odom(header)
        except (UnknownFrameError, NotConnectedError):
            if header.frame_id.lstrip("/") not in self._names:
                raise
            return Transform()
