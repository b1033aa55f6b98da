"""Topic on which a platform controller publishes its journal."""

from array import array

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from omniman_ros.control.journal import Journal
from omniman_ros.control.platform import PlatformController
from omniman_ros.nodes.omniman_node import OmnimanNode

TICKS = 20  #: Number of ticks in a message: the controller pays for one in twenty ticks only
QUEUE = QoSProfile(depth=100)  #: Quality of service: 10 s at 200 Hz may be sent again


class JournalOutput:
    """Publishes a controller's journal while somebody subscribes; each new one gets the state."""

    def __init__(self, node: OmnimanNode, core: PlatformController) -> None:
        self._node, self._journal = node, Journal(core)
        self._publisher = node.create_publisher(UInt8MultiArray, "controller_journal", QUEUE)
        self._subscribers, self._ticks = 0, 0

    def note_published(self, stamp: int) -> None:
        """Note the stamp [ns] of the last tick's command."""
        self._journal.note_published(stamp)

    def after_tick(self, at_once: bool) -> None:
        """Publish what is due; call this at the end of each tick.

        Args:
            at_once: Whether not to wait for further ticks, as the node ends.
        """
        self._ticks += 1
        if self._ticks % TICKS and not at_once:
            return
        if self._subscribers:
            self._publish()
        before, self._subscribers = self._subscribers, self._publisher.get_subscription_count()
        if self._subscribers > before:
            self._journal.open(self._node.ros_time())
            self._publish()
        elif not self._subscribers:
            self._journal.close()

    def _publish(self) -> None:
        self._publisher.publish(UInt8MultiArray(data=array("B", self._journal.take())))
