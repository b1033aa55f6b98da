"""Frames of what others send: transforms into odom, in which the page draws."""

from std_msgs.msg import Header

from omniman_ros.core.parameters import build
from omniman_ros.core.rigid import PlanarPose, Transform
from omniman_ros.core.transform_tree import Placement, TransformError
from omniman_ros.nodes.frame_parameters import FrameParameters, OdomFrame, TransformOptions
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.viewer.ros.parameters import ViewerParameters
from omniman_ros.viewer.view_state import ViewState


class PageFrames:
    """Places what others send, and says on the page what cannot be placed."""

    def __init__(self, node: OmnimanNode, parameters: ViewerParameters, state: ViewState) -> None:
        odom = OdomFrame(odom_frame=parameters.odom_frame, map_is_odom=parameters.map_is_odom)
        options = FrameParameters(odom=odom, tf=build(TransformOptions, {}))
        self._state = state
        self.transforms = FrameTransforms(node, lambda: options)  #: Transforms of the node

    def placement(self, topic: str, header: Header) -> Placement:
        """Return where the coordinates of a message are, in a frame that stands in the world.

        Raises:
            TransformError: Nothing relates the frame to odom at that time; the page says so until
                a message of the topic is placed.
        """
        try:
            placement = self.transforms.placement(header)
        except TransformError as error:
            self._state.unplaced[topic] = str(error)
            raise
        self._state.unplaced.pop(topic, None)
        return placement

    def into_odom(self, topic: str, header: Header) -> Transform:
        """Return the transform of a message's coordinates into odom as it is known now."""
        place = self.placement(topic, header)
        return self.transforms.anchor(place.frame) @ place.transform

    def pose(self, frame: str) -> PlanarPose:
        """Return the newest pose in odom [m, m, rad] of the frame of a placement.

        Raises:
            TransformError: There is none, and never was.
            InputError: The frame is tilted.
        """
        return self.transforms.anchor(frame).planar()
