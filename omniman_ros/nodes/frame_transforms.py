"""Transforms of a node's input into odom, by /tf and /tf_static."""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header

from omniman_ros.conversions.geometry import transform_from_message
from omniman_ros.conversions.headers import check_frame, is_stamped, time_seconds
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import Transform
from omniman_ros.core.stamps import TRANSFORM_LEAD, ClockWatch
from omniman_ros.core.transform_tree import ODOM, Placement, TransformError, TransformTree
from omniman_ros.nodes import tf_messages
from omniman_ros.nodes.frame_parameters import FrameParameters
from omniman_ros.nodes.omniman_node import OmnimanNode

M = TypeVar("M")

MOST_WAITING = 50  #: Largest number of messages of a topic that wait; the oldest wait no more
#: Period at which messages that wait for transforms are looked at, if none arrive [s]
RETRY_PERIOD = 0.05


class MessageFilter:
    """Hands the messages of a topic on in their order, each when its transforms are known.

    Args:
        handle_now: Handles a message that need not wait; its result is that of `handle`.
        handle_later: Handles a message that has waited, whether its transforms came or not.
    """

    def __init__(
        self,
        headers: Callable[[Any], Iterable[Header]],
        is_awaited: Callable[[Header], bool],
        give_up: Callable[[Iterable[Header]], None],
        handle_now: Callable[[Any], str | None],
        handle_later: Callable[[Any], None],
    ) -> None:
        self._headers, self._is_awaited, self._give_up = headers, is_awaited, give_up
        self._handle_now, self._handle_later = handle_now, handle_later
        self._waiting: deque[tuple[float, Any]] = deque()

    def handle(self, message: Any, now: float) -> str | None:
        """Handle a message that arrives at `now` [s]; return None if it waits."""
        if not self._waiting and self._is_ready(self._headers(message)):
            return self._handle_now(message)
        self._waiting.append((now, message))
        if len(self._waiting) > MOST_WAITING:
            self._handle_later(self._waiting.popleft()[1])
        return None

    def retry(self, now: float, max_wait: float) -> None:
        """Hand on the messages that have their transforms, or have waited for `max_wait` [s]."""
        while self._waiting:
            arrival, message = self._waiting[0]
            headers = list(self._headers(message))
            is_over = not 0.0 <= now - arrival < max_wait
            if not is_over and not self._is_ready(headers):
                return
            self._waiting.popleft()
            if is_over:
                self._give_up(headers)
            self._handle_later(message)

    def _is_ready(self, headers: Iterable[Header]) -> bool:
        return not any(self._is_awaited(header) for header in headers)


class FrameTransforms:
    """Listens to transforms, and has messages wait for theirs.

    What is given in a frame that moves with the robot, such as a sensor's, is transformed at its
    stamp. What is given in a frame that does not, such as `map`, stays there; where it is in odom
    is known from the newest transform only, as a localisation corrects itself.
    """

    def __init__(self, node: OmnimanNode, parameters: Callable[[], FrameParameters]) -> None:
        self._node, self._parameters = node, parameters
        self._tree = TransformTree()
        self._anchors: dict[str, Transform] = {}
        self._filters: list[MessageFilter] = []
        self._abandoned: set[str] = set()  #: Frames for which messages do not wait any more
        self._watch = ClockWatch()
        if tf_messages.TFMessage is None:
            node.get_logger().info("tf2_msgs is not installed: /tf is not received")
            return
        for topic, qos, is_static in (
            (tf_messages.TOPIC, tf_messages.LISTENER, False),
            (tf_messages.STATIC_TOPIC, tf_messages.STATIC_LISTENER, True),
        ):
            handler = self._handler(topic, is_static)
            node.create_subscription(tf_messages.TFMessage, topic, handler, qos)
        node.every(RETRY_PERIOD, self._retry)

    def _handler(self, topic: str, is_static: bool) -> Callable[[Any], None]:
        insert = self._node.guarded(topic, lambda stamped: self._insert(stamped, is_static))

        def handle(message: Any) -> None:
            self._notice_jump()
            for stamped in message.transforms:
                insert(stamped)
            self._retry()

        return handle

    def _insert(self, message: TransformStamped, is_static: bool) -> None:
        parent = message.header.frame_id.lstrip("/")
        child = message.child_frame_id.lstrip("/")
        if {parent, child} == set(self._parameters().odom.names):
            return  # odom and another name of it
        if not self._tree.is_child(child):
            self._abandoned.clear()  # it may relate them to odom
        if not is_static:  # the stamp of one that holds for ever means nothing
            try:
                self._node.age(message.header.stamp, TRANSFORM_LEAD)
            except InputError as error:
                raise type(error)(f"'{child[:40]}' in '{parent[:40]}': {error}") from error
        time = time_seconds(message.header.stamp)
        transform = transform_from_message(message.transform)
        now = 1e-9 * self._node.ros_time()
        self._tree.insert(parent, child, time, transform, is_static=is_static, now=now)

    def _notice_jump(self) -> None:
        """Forget the transforms if ROS time went back."""
        if self._watch.went_back(1e-9 * self._node.ros_time()):
            self._tree.clear()

    def placement(self, header: Header) -> Placement:
        """Return where the coordinates of a message with a header are.

        Args:
            header: Frame, and time at which the frame counts; a zero stamp means the newest.

        Raises:
            TransformError: Odom and the frame are not connected at that time.
            InputError: The stamp is too far ahead; see `TimedNode.demand_not_ahead`.
        """
        self._node.demand_not_ahead(header.stamp)
        odom = self._parameters().odom
        frame = header.frame_id.lstrip("/")
        if frame in odom.names:
            return Placement(ODOM)
        try:
            fixed = self._tree.ancestor(frame, odom.odom_frame)
            time = time_seconds(header.stamp) if is_stamped(header.stamp) else None
            transform = self._tree.lookup(fixed, frame, time)
            return Placement(ODOM if fixed == odom.odom_frame else fixed, transform)
        except TransformError as error:
            try:
                check_frame(frame, *odom.names)
            except InputError as expected:
                raise type(error)(f"{expected}, or one that TF relates to it: {error}") from error
            raise

    def mount(self, frame: str, base: str) -> Transform:
        """Return the newest pose of a frame in that of the robot, or raise TransformError."""
        return self._tree.lookup(base, frame.lstrip("/"), None)

    def anchor(self, frame: str) -> Transform:
        """Return the newest transform to odom from a frame that stands, or raise TransformError.

        After time went back, it is the last one that was used, until another one arrives.
        """
        if frame == ODOM:
            return Transform()
        odom = self._parameters().odom.odom_frame
        try:
            self._anchors[frame] = self._tree.lookup(odom, frame, None)
        except TransformError:
            if frame not in self._anchors:
                raise
        return self._anchors[frame]

    def into_odom(self, header: Header) -> Transform:
        """Return the transform into odom of coordinates as it is known now; see `placement`."""
        place = self.placement(header)
        return self.anchor(place.frame) @ place.transform

    def silence_reason(self, frame: str) -> str:
        """Return why the place of a frame in odom is not known any more, or an empty string."""
        parameters = self._parameters()
        odom, timeout = parameters.odom.odom_frame, parameters.tf.timeout
        if frame == ODOM or not timeout:
            return ""
        self._notice_jump()
        try:
            updated = self._tree.updated(odom, frame)
        except TransformError as error:
            return str(error)
        age = 1e-9 * self._node.ros_time() - updated
        return f"'{frame}' to '{odom}' is {age:.1f} s old" if age > timeout else ""

    def deferred(
        self,
        topic: str,
        headers: Callable[[M], Iterable[Header]],
        handler: Callable[[M], str | None],
    ) -> Callable[[M], str | None]:
        """Wrap a handler so that messages wait for the transforms of their `headers`, in order.

        The handler is called in any case: after the wait, its own lookup says what is missing.
        """
        handle_later = self._node.guarded(topic, handler)
        waiting = MessageFilter(headers, self._is_awaited, self._give_up, handler, handle_later)
        self._filters.append(waiting)
        return lambda message: waiting.handle(message, self._node.now())

    def end_waiting(self) -> None:
        """Hand on the messages that wait, because the node ends."""
        for waiting in self._filters:
            waiting.retry(self._node.now(), 0.0)

    def _retry(self) -> None:
        for waiting in self._filters:
            waiting.retry(self._node.now(), self._parameters().tf.wait)

    def _is_awaited(self, header: Header) -> bool:
        return header.frame_id not in self._abandoned and self._may_come(header)

    def _give_up(self, headers: Iterable[Header]) -> None:
        """Wait no more for frames that nothing relates to odom, until there are other frames."""
        self._abandoned.update(h.frame_id for h in headers if not self._is_related(h))

    def _may_come(self, header: Header) -> bool:
        """Return whether the transform of a header is missing, but may arrive yet."""
        if tf_messages.TFMessage is None or not self._tree:
            return False
        try:
            self.placement(header)
        except InputError as error:
            return isinstance(error, TransformError) and error.may_come
        return False

    def _is_related(self, header: Header) -> bool:
        """Return whether transforms relate the frame of a header to odom, at whatever time."""
        try:
            self._tree.ancestor(header.frame_id.lstrip("/"), self._parameters().odom.odom_frame)
        except TransformError:
            return False
        return True
