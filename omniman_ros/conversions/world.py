"""Convert what a simulated world tells: contacts, wheel loads, scans and true obstacles."""

from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped, Vector3
from sensor_msgs.msg import LaserScan
from std_msgs.msg import ColorRGBA, Float64MultiArray, Header, MultiArrayDimension
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters

if TYPE_CHECKING:
    # They need the physics engine, which this module does without.
    from omniman_ros.simulation.world.contacts import RobotContact
    from omniman_ros.simulation.world.world import Obstacle

OBSTACLE_COLOR = ColorRGBA(r=0.2, g=0.5, b=0.9, a=0.6)  #: Color of true obstacles


def contacts_message(
    contacts: "Sequence[RobotContact]", frame: str, stamp: Time
) -> DiagnosticArray:
    """Return the message for the contacts of the robot.

    Returns:
        One status per contact, of level WARN while they touch and OK afterwards. Its values are
        part and thing; x, y, z [m]; force_x, force_y, force_z [N]; impulse_x, impulse_y,
        impulse_z [N s]; part_speed and thing_speed just before they touched [m/s].
    """
    message = DiagnosticArray(header=Header(stamp=stamp, frame_id=frame))
    for contact in contacts:
        values = [KeyValue(key="part", value=contact.part)]
        values.append(KeyValue(key="thing", value=contact.element))
        for prefix, vector in (
            ("", contact.position),
            ("force_", contact.force),
            ("impulse_", contact.impulse),
        ):
            for axis, number in zip("xyz", vector.tolist(), strict=True):
                values.append(KeyValue(key=f"{prefix}{axis}", value=f"{number:.6g}"))
        for key, speed in (
            ("part_speed", contact.part_speed),
            ("thing_speed", contact.element_speed),
        ):
            values.append(KeyValue(key=key, value=f"{speed:.6g}"))
        level = DiagnosticStatus.WARN if contact.touches else DiagnosticStatus.OK
        verb = "touches" if contact.touches else "touched"
        message.status.append(
            DiagnosticStatus(
                level=level,
                name=f"{contact.part}, {contact.element}",
                message=f"{contact.part} {verb} {contact.element}",
                values=values,
            )
        )
    return message


def wheel_loads_message(loads: Array) -> Float64MultiArray:
    """Return the message for the loads (n,) of n wheels [N]."""
    message = Float64MultiArray(data=loads.tolist())
    message.layout.dim = [
        MultiArrayDimension(label="wheel", size=len(loads), stride=len(loads)),
        MultiArrayDimension(label="load", size=1, stride=1),
    ]
    return message


def scan_message(
    ranges: Array, scanner: ScannerParameters, period: float, stamp: Time
) -> LaserScan:
    """Return the message for a scan whose beams are all measured at once.

    Args:
        ranges: Ranges (beams,), infinite without a return, as in REP 117 [m].
        period: Time between two scans [s].
    """
    half = 0.5 * scanner.field_of_view
    return LaserScan(
        header=Header(stamp=stamp, frame_id=scanner.name),
        angle_min=-half,
        angle_max=half,
        angle_increment=scanner.field_of_view / (scanner.beams - 1),
        scan_time=period,
        range_min=scanner.range_min,
        range_max=scanner.range_max,
        ranges=array("f", ranges.astype(np.float32).tobytes()),
    )


def scanner_transform(
    scanner: ScannerParameters, base_frame: str, stamp: Time
) -> TransformStamped:
    """Return the pose in which a scanner is said to be mounted."""
    result = TransformStamped(
        header=Header(stamp=stamp, frame_id=base_frame), child_frame_id=scanner.name
    )
    result.transform.translation = Vector3(x=scanner.x, y=scanner.y, z=scanner.z)
    result.transform.rotation = quaternion_from_yaw(scanner.yaw)
    return result


def obstacle_markers(obstacles: "Sequence[Obstacle]", frame: str) -> MarkerArray:
    """Return one marker per obstacle: a cylinder or a box of its true size.

    Returns:
        Markers whose namespace is the obstacle's name, with number 0; poses and stamp are still to
        be written by :func:`fill_obstacle_markers`.
    """
    markers = []
    for obstacle in obstacles:
        length, width, height = obstacle.size
        marker = Marker(
            header=Header(frame_id=frame),
            ns=obstacle.name,
            type=Marker.CYLINDER if obstacle.is_round else Marker.CUBE,
            action=Marker.ADD,
            color=OBSTACLE_COLOR,
            scale=Vector3(x=length, y=width, z=height),
        )
        marker.pose.position.z = 0.5 * height
        markers.append(marker)
    return MarkerArray(markers=markers)


def fill_obstacle_markers(
    message: MarkerArray, obstacles: "Sequence[Obstacle]", stamp: Time
) -> None:
    """Write the poses of obstacles into their markers, see :func:`obstacle_markers`."""
    for marker, obstacle in zip(message.markers, obstacles, strict=True):
        x, y, heading = obstacle.pose
        marker.header.stamp = stamp
        marker.pose.position.x, marker.pose.position.y = x, y
        marker.pose.orientation = quaternion_from_yaw(heading)
