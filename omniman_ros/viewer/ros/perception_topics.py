"""Subscriptions to what the robot perceives, which update `Perceived`."""

import math
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import JointState, LaserScan, PointCloud2
from std_msgs.msg import Float64, Header
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.arm import joint_points
from omniman_ros.conversions.headers import check_frame
from omniman_ros.conversions.maps import map_from_message
from omniman_ros.conversions.motion_limits import motion_limit_fractions
from omniman_ros.conversions.perceived import contact_position, tracked_obstacles
from omniman_ros.conversions.scans import scan_from_message
from omniman_ros.core import plausible, se2
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import Transform
from omniman_ros.core.transform_tree import TransformError
from omniman_ros.motion.axes import PLATFORM_AXES, PLATFORM_COLUMNS
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.obstacle_tracker_parameters import LASER, ScannerInput
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.perception.scan import placed
from omniman_ros.viewer.body_view import BodyShapes, BodyView, obstacles_around
from omniman_ros.viewer.lines import thinned
from omniman_ros.viewer.map_image import Pixels, map_image, map_pixels
from omniman_ros.viewer.perceived import Contact, Tracks
from omniman_ros.viewer.ros.lazy_subscriptions import LATEST_READING, LazySubscriptions
from omniman_ros.viewer.ros.parameters import ViewerParameters
from omniman_ros.viewer.view_state import ViewState

MAX_POINTS = 1500  #: Largest number of points drawn of a scan; more are thinned evenly
MAX_TRACKS = 100  #: Largest number of tracked obstacles drawn
MAX_GHOSTS = 20  #: Largest number of instants of a plan
MAX_CONTACTS = 50  #: Largest number of contacts drawn


class PerceptionTopics:
    """Receives scans, map, tracked obstacles, contacts, limits of speed and tip-over margin.

    All of them are subscribed only while a browser is connected.
    """

    def __init__(
        self,
        node: OmnimanNode,
        subscriptions: LazySubscriptions,
        state: ViewState,
        parameters: ViewerParameters,
        frames: FrameTransforms,
    ) -> None:
        self._node, self._state, self._parameters = node, state, parameters
        self._frames = frames
        self._map: tuple[Header, Pixels, float, Array] | None = None
        self._shapes: dict[bool, BodyShapes] = {}
        watch = subscriptions.subscribe_while_watched
        for scanner in parameters.scanners:
            if scanner.kind == LASER:
                handler = partial(self._on_scan, scanner)
                watch(LaserScan, scanner.topic, handler, LATEST_READING)
        watch(OccupancyGrid, "map", self._on_map, LATCHED)
        watch(PointCloud2, "obstacle_tracks", self._on_tracks)
        watch(DiagnosticArray, "contacts", self._on_contacts, 10)
        watch(JointState, "motion_limit", self._on_limit)
        watch(Float64, "tip_over_margin", self._on_margin)
        watch(JointTrajectory, "body/plan", self._on_plan)

    def update_state(self, layers: frozenset[str]) -> None:
        """Update what depends on the newest transforms or values, for the drawn layers."""
        self._place_map()
        self._state.perceived.body = self._body() if "shapes for distances" in layers else None

    def _body(self) -> BodyView | None:
        """Return the robot's shapes and what is nearest to them; None if its pose is unknown."""
        state = self._state
        if state.odom is None:
            return None
        pose = np.array(state.odom)
        obstacles = obstacles_around(
            pose, state.other_obstacles, state.obstacles, state.perceived.scan.points
        )
        joints = np.zeros(JOINTS) if state.arm is None else state.arm
        return self._body_shapes(state.arm is not None).view(pose, joints, obstacles)

    def _body_shapes(self, has_arm: bool) -> BodyShapes:
        if has_arm not in self._shapes:
            self._shapes[has_arm] = self._parameters.shapes(with_arm=has_arm)
        return self._shapes[has_arm]

    def _on_plan(self, message: JointTrajectory) -> None:
        """Take the plan of the whole body, past obstacles that go on as they move now."""
        check_frame(message.header.frame_id, *self._parameters.frames)
        names = (*PLATFORM_AXES, *self._parameters.arm.joints)
        points = joint_points(message, names, MAX_GHOSTS)
        if len(points.columns) < len(names):
            raise InputError(f"it has {len(points.columns)} axes, expected {len(names)}")
        plan = points.positions[:, np.argsort(points.columns)]
        times = np.zeros(len(plan)) if points.times is None else points.times
        state, nothing = self._state, np.zeros((0, 3))
        around = [
            obstacles_around(pose, state.other_obstacles, state.obstacles, nothing, time)
            for pose, time in zip(plan[:, PLATFORM_COLUMNS], times.tolist(), strict=True)
        ]
        view = self._body_shapes(True).plan_view(plan, around)
        self._state.perceived.update_plan(view, self._node.now())

    def _place_map(self) -> None:
        if self._map is None:
            return
        header, pixels, size, corner = self._map
        try:
            anchor = self._frames.into_odom(header).planar()
        except TransformError:  # its transform may come later
            self._state.perceived.map = None
            return
        x, y, theta = corner.tolist()
        place = np.array(se2.compose(anchor, (x, y, theta)))
        shown = self._state.perceived.map
        image = map_image(pixels, size, place)
        if shown is None or shown.pixels is not pixels or shown.middle != image.middle:
            self._state.perceived.map = image

    def _on_scan(self, scanner: ScannerInput, message: LaserScan) -> None:
        pose = self._state.odom
        if pose is None:
            raise InputError("there is no odometry yet")
        mount = self._mount(scanner, message.header.frame_id)
        scan = scan_from_message(message, mount, lambda stamp: 0.0, scanner.no_return)
        hits = scan.hits[list(thinned(len(scan.hits), MAX_POINTS))]
        points = scan.local_points(hits)
        plausible.demand(points, plausible.LENGTH, "points")
        flat = placed(points, np.broadcast_to(np.array(pose), (len(points), 3)))
        heights = np.full(len(flat), scan.heights[0])
        self._state.perceived.update_scan(
            scanner.topic, np.column_stack((flat, heights)), self._node.now()
        )

    def _mount(self, scanner: ScannerInput, frame: str) -> Transform:
        p = self._parameters
        return self._frames.mount(frame, p.base_frame) if p.scanners_by_tf else scanner.mount

    def _on_map(self, message: OccupancyGrid) -> None:
        received = map_from_message(message)
        pixels, count = map_pixels(received.values)
        size = count * received.resolution
        last = self._map
        if last is not None and np.array_equal(last[1], pixels):
            pixels = last[1]  # the image is not sent again
        self._map = message.header, pixels, size, received.origin

    def _on_tracks(self, message: PointCloud2) -> None:
        check_frame(message.header.frame_id, *self._parameters.frames)
        rows = tracked_obstacles(message)
        rows = rows[list(thinned(len(rows), MAX_TRACKS))]
        deviations = np.sqrt(rows[:, 5:7])
        tracks = Tracks(rows[:, 0:2], rows[:, 2:4], rows[:, 4], deviations[:, 0], deviations[:, 1])
        self._state.perceived.update_tracks(tracks, self._node.now())

    def _on_contacts(self, message: DiagnosticArray) -> None:
        contacts, now = self._state.perceived.contacts, self._node.now()
        for status in message.status[:MAX_CONTACTS]:
            if status.level == DiagnosticStatus.OK:
                contacts.pop(status.name, None)
                continue
            place, force = contact_position({item.key: item.value for item in status.values})
            contacts[status.name] = Contact(status.message, place, force, now)

    def _on_limit(self, message: JointState) -> None:
        fractions = motion_limit_fractions(message)
        self._state.perceived.update_speed_fractions(fractions, self._node.now())

    def _on_margin(self, message: Float64) -> None:
        if not math.isfinite(message.data):
            raise InputError(f"{message.data} must be finite")
        self._state.perceived.update_margin(message.data, self._node.now())
