"""Update of a set of obstacles from markers, for every node that keeps obstacles."""

from collections.abc import Callable

from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.obstacles import marker_changes
from omniman_ros.core.errors import InputError
from omniman_ros.core.transform_tree import Placement
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.planning.obstacles.framed_obstacles import FramedObstacles
from omniman_ros.planning.obstacles.obstacles import Observation, ObstacleSet


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
    """Apply the valid changes of a message in their order.

    A message without any valid change does not count as a sign of life of its source; an empty
    message does: it reports that there are no obstacles.

    Args:
        node: Node whose clock is used.
        message: Markers to add, change or delete.
        obstacles: Obstacles to update; a plain set takes what is placed in odom only.
        place: Returns where the coordinates under a header are.

    Returns:
        Why each of the invalid changes was ignored.
    """
    now = node.now()
    changes, faults = marker_changes(message, place, lambda stamp: min(node.instant(stamp), now))
    is_alive = not message.markers
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
        is_alive = True
    if is_alive:
        obstacles.note_message(now)
    return faults
