"""Obstacles from markers, for every node that keeps obstacles."""

from collections.abc import Callable

from rclpy.qos import QoSProfile
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.obstacles import marker_changes
from omniman_ros.core.errors import InputError
from omniman_ros.core.source_monitor import SourceMonitor, SourceTerms
from omniman_ros.core.transform_tree import Placement
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.source_watch import SourceWatch
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.framed_obstacles import FramedObstacles
from omniman_ros.surroundings.obstacles import (
    Key,
    Observation,
    ObstacleParameters,
    ObstacleSet,
)


class ObstacleInterface:
    """Keeps the obstacles of `obstacles`."""

    def __init__(
        self,
        node: OmnimanNode,
        frames: FrameTransforms,
        parameters: ObstacleParameters,
        watch: SourceWatch,
    ) -> None:
        self._node, self._frames, self._watch = node, frames, watch
        self._known = FramedObstacles(parameters)
        self._source = SourceMonitor("obstacles", _terms(parameters))
        watch.subscribe(
            MarkerArray, self._source, marker_headers, self._receive, QoSProfile(depth=50)
        )

    def configure(self, parameters: ObstacleParameters) -> None:
        """Use other parameters."""
        self._known.configure(parameters)
        self._source.terms = _terms(parameters)

    def __len__(self) -> int:
        return len(self._known)

    @property
    def keys(self) -> tuple[Key, ...]:
        """Keys of the obstacles, in the order of `ellipses` at the same time."""
        return self._known.keys

    def ellipses(self) -> Ellipses:
        """Return the obstacles in odom now."""
        return self._known.ellipses(
            self._node.now(), lambda frame: self._frames.anchor(frame).planar()
        )

    def dismiss_silent_source(self) -> None:
        """Stop waiting for a silent source of obstacles that no longer exists.

        Only a new task justifies this: somebody has sent it without the source. A motion that was
        under way when the source fell silent stays stopped.
        """
        if not self._source.blind_reason(self._node.now()):
            return
        self._watch.survey()
        if self._source.dismiss():
            text = "the source of obstacles is gone: the last known obstacles are used"
            self._node.warn("source gone", text)

    def _receive(self, message: MarkerArray) -> str:
        faults = update_obstacles(self._node, message, self._known, self._frames.placement)
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        return faults[0] + more if faults else ""


def _terms(parameters: ObstacleParameters) -> SourceTerms:
    return SourceTerms(parameters.timeout, parameters.timeout, parameters.required)


def marker_headers(message: MarkerArray) -> list[Header]:
    """Return the headers of the markers that place an obstacle; of equal ones, one."""
    headers: list[Header] = []
    for marker in message.markers:
        if marker.action == Marker.ADD and marker.header not in headers[-1:]:
            headers.append(marker.header)
    return headers


def update_obstacles(
    node: OmnimanNode,
    message: MarkerArray,
    obstacles: FramedObstacles | ObstacleSet,
    place: Callable[[Header], Placement],
) -> list[str]:
    """Apply the valid changes of a message in order; return why each invalid one was ignored.

    Args:
        obstacles: Obstacles to update; a plain set takes what is placed in odom only.
    """
    now = node.now()
    changes, faults = marker_changes(message, place, lambda stamp: min(node.instant(stamp), now))
    for change in changes:
        if isinstance(change, Observation):
            try:
                obstacles.add(change, now)
            except InputError as error:
                faults.append(str(error))
                continue
        elif change.number is None:
            obstacles.delete_all(change.namespace)
        else:
            obstacles.delete((change.namespace, change.number))
    return faults
