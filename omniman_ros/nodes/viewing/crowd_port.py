"""The obstacles of the page: what is done to them, and how other nodes see them."""

import math
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Vector3
from rclpy.publisher import Publisher
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros import conversions
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.planning.cases import Case, Turned
from omniman_ros.viewer.crowd import RADIUS, Crowd
from omniman_ros.viewer.events import (
    ObstacleChosen,
    ObstacleDeleted,
    ObstacleDragged,
    ObstacleSent,
    ObstacleShaped,
)
from omniman_ros.viewer.state import Picture

NAMESPACES = ("viewer", *(f"viewer_{k}" for k in range(2, 10)))
"""Of the markers: the first that nobody else uses."""
PERIOD = 0.1
"""Of the markers [s]."""
LIFETIME = 1.0
"""Of a marker, should this node end without a word [s]."""
HEIGHT = 0.5
"""Of the cylinders [m]."""
AHEAD = 1.2
"""A new obstacle is put so far in front of the robot [m] ..."""
ROOM = 0.15
"""... with so much between it and the others [m] ..."""
ASIDE = tuple((k + 1) // 2 * (0.3 if k % 2 else -0.3) for k in range(60))
"""... at the first of these distances to the left that is clear [m], else at the last."""
_COLOUR = ColorRGBA(r=0.61, g=0.21, b=0.09, a=0.8)


class CrowdPort:
    """Output `obstacles`, of what the page has placed.

    Args:
        node: Whose.
        picture: Shows the obstacles.
        frame: Of the obstacles.

    Attributes:
        crowd: They.
        namespace: Of their markers, empty before there was one.
    """

    def __init__(self, node: OmnimanNode, picture: Picture, frame: str) -> None:
        self._node = node
        self._picture = picture
        self._frame = frame
        self.crowd = Crowd()
        self.namespace = ""
        self._publisher: Publisher | None = None
        self._alone = True
        self._told: set[int] = set()
        self._sent_at = -math.inf
        self._others: dict[str, float] = {}
        self._ending = False

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """The publisher, if there was an obstacle."""
        return () if self._publisher is None else (self._publisher,)

    def ours(self, namespace: str) -> bool:
        """Whether markers heard in a namespace are those of this page; others are remembered."""
        if namespace == self.namespace:
            return bool(namespace)
        if namespace in NAMESPACES:
            self._others[namespace] = self._node.now()
        return False

    # ---- what the page does -------------------------------------------------------------------

    def add(self, now: float) -> None:
        """Add an obstacle in front of the robot, beside those that are there.

        Raises:
            InputError: There are too many.
        """
        x, y, theta = self._picture.odom or (0.0, 0.0, 0.0)
        taken = self.crowd.rows(now)
        clear = RADIUS + ROOM + taken.semi_axes.max(axis=1, initial=0.0)
        forward = np.array([math.cos(theta), math.sin(theta)])
        left = np.array([-forward[1], forward[0]])
        first = place = np.array([x, y]) + AHEAD * forward
        for aside in ASIDE:
            place = first + aside * left
            if (np.hypot(*(taken.centers - place).T) >= clear).all():
                break
        self._picture.chosen = self.crowd.add(Turned((float(place[0]), float(place[1]))), now)

    def load(self, case: Case, now: float) -> None:
        """Have the obstacles of a case and no others, held."""
        self.crowd.delete(None)
        self.crowd.restart(now)
        self.crowd.hold(now)
        for way in case.ways:
            self.crowd.add(way, now, (case.radius, case.radius))
        self._picture.chosen = None

    def drag(self, event: ObstacleDragged, now: float) -> None:
        """Put one at a place.

        Raises:
            InputError: There is none, or the place cannot be.
        """
        self.crowd.put(event.number, event.place, now)
        self._picture.chosen = event.number

    def send(self, event: ObstacleSent, now: float) -> None:
        """Give one a velocity.

        Raises:
            InputError: There is none, or it cannot be so fast.
        """
        self.crowd.send(event.number, event.velocity, now)

    def shape(self, event: ObstacleShaped, now: float) -> None:
        """Give one semi-axes and a heading.

        Raises:
            InputError: There is none, or it cannot be so.
        """
        self.crowd.shape(event.number, event.semi_axes, event.angle)

    def choose(self, event: ObstacleChosen, now: float) -> None:
        """Choose one, or none.

        Raises:
            InputError: There is none of that number.
        """
        if event.number is not None:
            self._known(event.number)
        self._picture.chosen = event.number

    def delete(self, event: ObstacleDeleted, now: float) -> None:
        """Delete one, or all.

        Raises:
            InputError: There is none of that number.
        """
        if event.number is not None:
            self._known(event.number)
        self.crowd.delete(event.number)

    def _known(self, number: int) -> None:
        if number not in self.crowd:
            raise InputError(f"there is no obstacle {number}")

    # ---- what others see ----------------------------------------------------------------------

    def show(self, now: float) -> None:
        """Put them into the picture, where they are now."""
        picture = self._picture
        picture.crowd = self.crowd.rows(now)
        picture.holding = self.crowd.held
        if picture.chosen is not None and picture.chosen not in self.crowd:
            picture.chosen = None

    def survey(self) -> None:
        """Look whether others report obstacles."""
        if self._publisher is not None:
            ours = (self._node.get_name(), self._node.get_namespace())
            self._alone = all(
                (info.node_name, info.node_namespace) == ours
                for info in self._node.get_publishers_info_by_topic("obstacles")
            )

    def publish(self, now: float) -> None:
        """Send what is there and what is gone; call it once a period.

        A planner that has heard of obstacles does not drive when their source falls silent. So
        after the last obstacle is deleted this goes on saying that there is none, unless there
        is another source: its silence must be noticed.
        """
        rows = self.crowd.rows(now)
        gone = self._told.difference(rows.numbers.tolist())
        if self._ending or not (gone or now - self._sent_at > PERIOD - 1e-6):
            return
        if self._publisher is None:
            if not len(rows.numbers):
                return
            self._open(now)
        header = Header(stamp=self._node.stamp(), frame_id=self._frame)
        message = MarkerArray(markers=[self._deletion(header, number) for number in sorted(gone)])
        if gone and not len(rows.numbers):
            message.markers = [self._deletion(header, None)]
        columns = (rows.numbers, rows.centers, rows.semi_axes, rows.angles)
        for row in zip(*(column.tolist() for column in columns), strict=True):
            message.markers.append(self._marker(header, *row))
        if message.markers or self._alone:
            assert self._publisher is not None
            self._publisher.publish(message)
            self._told, self._sent_at = set(rows.numbers.tolist()), now

    def start_over(self, now: float) -> None:
        """Time went back: begin anew."""
        self.crowd.restart(now)
        self._others.clear()
        self._sent_at = -math.inf

    def end(self) -> None:
        """Take all away, for good."""
        if self._publisher is not None and not self._ending:
            header = Header(stamp=self._node.stamp(), frame_id=self._frame)
            self._publisher.publish(MarkerArray(markers=[self._deletion(header, None)]))
        self.crowd.delete(None)
        self._ending = True

    def _open(self, now: float) -> None:
        """Begin to report, under a name that no other viewer uses."""
        used = {name for name, heard in self._others.items() if now - heard < 2.0 * LIFETIME}
        self.namespace = next((n for n in NAMESPACES if n not in used), NAMESPACES[-1])
        self._publisher = self._node.create_publisher(MarkerArray, "obstacles", 10)

    def _deletion(self, header: Header, number: int | None) -> Marker:
        action = Marker.DELETEALL if number is None else Marker.DELETE
        return Marker(header=header, ns=self.namespace, id=number or 0, action=action)

    def _marker(
        self, header: Header, number: int, place: list[float], axes: list[float], angle: float
    ) -> Any:
        return Marker(
            header=header, ns=self.namespace, id=number, type=Marker.CYLINDER, action=Marker.ADD,
            pose=Pose(
                position=Point(x=place[0], y=place[1], z=0.5 * HEIGHT),
                orientation=conversions.quaternion(angle),
            ),
            scale=Vector3(x=2.0 * axes[0], y=2.0 * axes[1], z=HEIGHT), color=_COLOUR,
            lifetime=Duration(sec=int(LIFETIME), nanosec=round(LIFETIME % 1.0 * 1e9)),
        )  # fmt: skip
