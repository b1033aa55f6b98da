"""Publish what a simulated inertial measurement unit measures."""

from collections.abc import Callable

from builtin_interfaces.msg import Time
from sensor_msgs.msg import Imu

from omniman_ros.conversions.imu import imu_message, imu_transform
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.nodes.static_transforms import StaticTransforms
from omniman_ros.simulation.plant.imu import BaseMotion, SimulatedImu


class ImuPublisher:
    """Publishes imu, and the pose of its frame on /tf_static."""

    def __init__(
        self,
        node: OmnimanNode,
        parameters: SimulatedDriveParameters,
        motion: Callable[[], BaseMotion],
    ) -> None:
        p = parameters
        self._node, self._motion, self._base_frame = node, motion, p.base_frame
        self._every = max(1, round(p.state_rate / p.imu_rate))
        self._count = 0
        self._imu = SimulatedImu(p.imu, p.imu_sensor, p.simulation.plant.gravity, p.seed)
        self._publisher = node.create_publisher(Imu, "imu", 10)
        self._mount = StaticTransforms(node, "imu.*")
        self.configure(p)

    def configure(self, parameters: SimulatedDriveParameters) -> None:
        """Measure with new parameters from now on."""
        p = parameters
        self._frame = p.imu.frame
        self._imu.configure(p.imu, p.imu_sensor, p.simulation.plant.gravity)
        self._mount.publish([imu_transform(p.imu, self._base_frame, self._node.stamp())])

    def publish(self, now: float, stamp: Time) -> None:
        """Publish a measurement if one is due; call this once a report."""
        self._count += 1
        if self._count % self._every != 0:
            return
        measured = self._imu.measure(now, self._motion())
        if measured is not None:
            self._publisher.publish(imu_message(*measured, self._frame, stamp))
