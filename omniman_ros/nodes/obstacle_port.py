"""Markers of obstacles into a set of them, as every node hears them that needs to know."""

from collections.abc import Sequence

from visualization_msgs.msg import MarkerArray

from omniman_ros import conversions
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.planning.obstacles import Observation, ObstacleSet


def hear(
    node: OmnimanNode, message: MarkerArray, obstacles: ObstacleSet, frames: Sequence[str]
) -> list[str]:
    """Take in what the markers change, in their order; what is wrong with the others.

    A message of which nothing could be used does not count as a sign of life of its source; an
    empty one does: there is nothing to see.
    """
    now = node.now()
    changes, complaints = conversions.marker_changes(
        message, frames, lambda stamp: now - max(node.age(stamp), 0.0), Observation
    )
    used = not message.markers
    for change in changes:
        if isinstance(change, Observation):
            try:
                obstacles.add(change, now)
            except InputError as error:
                complaints.append(str(error))
                continue
        elif change.number is None:
            obstacles.delete_all(change.namespace)
        else:
            obstacles.delete((change.namespace, change.number))
        used = True
    if used:
        obstacles.heard(now)
    return complaints
