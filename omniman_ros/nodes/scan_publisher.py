"""Publish the scans of the laser scanners of a simulated world."""

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from sensor_msgs.msg import LaserScan

from omniman_ros.conversions.world import scan_message, scanner_transform
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.static_transforms import StaticTransforms
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters

if TYPE_CHECKING:
    from omniman_ros.simulation.world.world import World


class ScanPublisher:
    """Publishes the scans, and where the scanners are mounted.

    A single scanner publishes on `scan`, several on `NAME/scan`.

    Args:
        state_rate: Number of calls of `publish` in a second [Hz].
    """

    def __init__(
        self,
        node: OmnimanNode,
        world: "World",
        scanners: tuple[ScannerParameters, ...],
        base_frame: str,
        state_rate: float,
        seed: int,
    ) -> None:
        # Here, so that a machine without the engine can import this module.
        from omniman_ros.simulation.world.scanner import Scanner

        self._node, self._base_frame, self._state_rate = node, base_frame, state_rate
        self._scanners = [Scanner(world, p, seed + k) for k, p in enumerate(scanners)]
        topics = [f"{p.name}/scan" for p in scanners] if len(scanners) > 1 else ["scan"]
        self._publishers = [node.create_publisher(LaserScan, topic, 5) for topic in topics]
        self._every = [max(1, round(state_rate / p.rate)) for p in scanners]
        self._mounts = StaticTransforms(node, "scanners.*")
        self._count = 0
        self._publish_transforms()

    def configure(self, scanners: tuple[ScannerParameters, ...]) -> None:
        """Measure with other parameters from now on; their number stays the same."""
        if scanners == tuple(scanner.parameters for scanner in self._scanners):
            return
        for scanner, parameters in zip(self._scanners, scanners, strict=True):
            scanner.configure(parameters)
        self._publish_transforms()

    def _publish_transforms(self) -> None:
        stamp = self._node.stamp()
        self._mounts.publish(
            [
                scanner_transform(scanner.parameters, self._base_frame, stamp)
                for scanner in self._scanners
            ]
        )

    def publish(self, stamp: Time) -> None:
        """Publish what is due in one report."""
        self._count += 1
        for scanner, publisher, every in zip(
            self._scanners, self._publishers, self._every, strict=True
        ):
            ranges = scanner.scan() if self._count % every == 0 else None
            if ranges is not None:
                period = every / self._state_rate
                publisher.publish(scan_message(ranges, scanner.parameters, period, stamp))
