"""Node `viewer`: a page in the browser that shows the robot and drives it by hand."""

import queue
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist as TwistMsg
from geometry_msgs.msg import TwistStamped, Vector3
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from omniman_ros import conversions
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.framing import Framing, Twist
from omniman_ros.core.parameters import REQUIRED, build, inline, parameter
from omniman_ros.core.robot import Robot
from omniman_ros.nodes import obstacle_port
from omniman_ros.nodes.movers import Calls, nodes_that_move
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run
from omniman_ros.nodes.stopping import ALL_LATCHED, LATCHED
from omniman_ros.planning.obstacles import ObstacleParameters, ObstacleSet
from omniman_ros.viewer import availability
from omniman_ros.viewer.hold import DEAD_MAN, HoldToDrive, Pressed
from omniman_ros.viewer.state import Array, Condition, Picture, Pose, outlines, thinned

PERIOD = 0.05
"""Of cmd_vel, and of looking for what was pressed [s]."""
EVENTS = 1000
"""Events of the page that are served in one period at most."""
CALLING = 4.0
"""How long nodes are looked for that a stop or a reset is meant for [s]."""
SHOWN = 100
"""So many obstacles are drawn at most; of more, every second, third, ..."""
PATH_SERVICES = tuple(f"path_interpolator/{action}" for action in ("pause", "resume", "cancel"))
_LATEST = QoSProfile(depth=1)


@dataclass(frozen=True)
class DrivingLimits:
    """Bounds of the sliders; the platform controller has the limits that hold."""

    linear_velocity: float = parameter(
        REQUIRED, "Largest linear speed of the buttons.", unit="m/s", low=1e-3, high=20,
        read_only=True,
    )  # fmt: skip
    angular_velocity: float = parameter(
        REQUIRED, "Largest yaw rate of the buttons.", unit="rad/s", low=1e-3, high=50,
        read_only=True,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ViewerParameters:
    """Parameters of the node: the robot as it looks, where the page is, rates and frames."""

    robot: Robot = inline()
    limits: DrivingLimits
    host: str = parameter(
        "127.0.0.1", "Address to serve the page on; who can reach it can drive the robot.",
        read_only=True,
    )  # fmt: skip
    port: int = parameter(
        8080, "Port of the page; if it is taken, the next one that is free.", low=1, high=65535,
        read_only=True,
    )  # fmt: skip
    frame_rate: float = parameter(
        25.0, "Frames of the page, while a browser is there.", unit="Hz", low=1, high=60,
        read_only=True,
    )  # fmt: skip
    odom_frame: str = parameter("odom", "Frame of paths and references.", read_only=True)
    map_is_odom: bool = parameter(
        False, "Whether paths in `map` are taken for odom.", read_only=True
    )
    base_frame: str = parameter("base_link", "Frame of twists.", read_only=True)
    cmd_vel_stamped: bool = parameter(False, "Whether cmd_vel is a TwistStamped.", read_only=True)


class ViewerNode(OmnimanNode):
    """Message plumbing between the topics and the page.

    The page has threads of its own; they put what is pressed into a queue, which this node
    empties in its own time. Nothing here waits for a browser.

    Args:
        make_page: Makes the page, see `viewer.page.Page`.
    """

    def __init__(self, make_page: Callable[..., Any] | None = None, **options: object) -> None:
        super().__init__("viewer", **options)
        self.settings = ParameterSet(self, ViewerParameters)
        p = self.settings.value
        self._names = p.robot.wheels.names
        self._frames = (p.odom_frame, "map") if p.map_is_odom else (p.odom_frame,)
        constraints = len(self._names) - 3
        self.picture = Picture(len(self._names), constraints)
        self._obstacles = ObstacleSet(build(ObstacleParameters, {}))
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._hold = HoldToDrive()
        self._framing = Framing()
        self._silent = True
        self._served_at = self.now()
        self._calls: tuple[str, Calls, float] | None = None
        self._answering: dict[str, Any] = {}
        self._waiting: dict[str, Callable[[], None]] = {}
        self._watching: list[Any] = []
        self._path_clients = {name: self.create_client(Trigger, name) for name in PATH_SERVICES}
        kind = TwistStamped if p.cmd_vel_stamped else TwistMsg
        self._cmd_vel = self.create_publisher(kind, "cmd_vel", _LATEST)
        self._make_inputs()
        limits = (p.limits.linear_velocity, p.limits.angular_velocity)
        if make_page is None:
            from omniman_ros.viewer.page import Page as make_page
        self.page = make_page(p.robot, constraints, limits, p.host, p.port, self._events.put)
        self.get_logger().info(f"the page is at {self.page.address}")
        self.every(PERIOD, self.serve)
        self.every(1.0 / p.frame_rate, self.draw)
        self.every(1.0, self.survey)

    # ---- inputs -------------------------------------------------------------------------------

    def _make_inputs(self) -> None:
        for kind, topic, handler, qos in (
            (Odometry, "odom", self._on_odom, _LATEST),
            (Odometry, "ground_truth/odom", self._on_truth, _LATEST),
            (Path, "path", self._on_path, 10),
            (MultiDOFJointTrajectory, "path/reference", self._on_reference, _LATEST),
            (Path, "mpc/plan", self._on_plan, _LATEST),
            (MarkerArray, "obstacles", self._on_obstacles, 50),
            (Float64, "path_progress", self._on_progress, _LATEST),
            (String, "active_source", self._on_source, LATCHED),
            (DiagnosticStatus, "stop_state", self._on_stop_state, ALL_LATCHED),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 50),
        ):
            self._subscribe(kind, topic, handler, qos)

    def _subscribe(
        self, kind: type, topic: str, handler: Callable[[Any], None], qos: QoSProfile | int
    ) -> Any:
        keep_last = qos is _LATEST
        take = self._keeper(topic, handler) if keep_last else self.guarded(topic, handler)
        return self.create_subscription(kind, topic, take, qos)

    def _listen(self, watched: bool) -> None:
        """Hear what comes 200 times a second only while somebody looks: it costs the most."""
        if watched and not self._watching:
            self._watching = [
                self._subscribe(JointState, topic, handler, _LATEST)
                for topic, handler in (
                    ("wheel_states", self._on_wheels),
                    ("wheel_commands", self._on_commands),
                    ("coupling_error", self._on_coupling),
                )
            ]
        elif not watched:
            while self._watching:
                self.destroy_subscription(self._watching.pop())

    def _keeper(self, topic: str, handler: Callable[[Any], None]) -> Callable[[Any], None]:
        """Keep the last message only, until it is taken in: a stream comes faster than frames."""
        guarded = self.guarded(topic, handler)

        def keep(message: Any) -> None:
            self._waiting[topic] = lambda: guarded(message)

        return keep

    def _take_in(self) -> None:
        while self._waiting:
            self._waiting.popitem()[1]()

    def _on_wheels(self, message: JointState) -> None:
        position, velocity, _ = conversions.joint_arrays(message, self._names)
        for values, bound, label in (
            (position, plausible.WHEEL_ANGLE, "position"),
            (velocity, plausible.WHEEL_SPEED, "velocity"),
        ):
            if values is not None:
                plausible.demand(values, bound, label)
        self.picture.hear_wheels(position, velocity, self.now())

    def _on_commands(self, message: JointState) -> None:
        _, velocity, _ = conversions.joint_arrays(message, self._names)
        if velocity is not None:
            plausible.demand(velocity, plausible.WHEEL_SPEED, "velocity")
        self.picture.hear_commands(velocity, self.now())

    def _on_odom(self, message: Odometry) -> None:
        self.picture.hear_odom(_pose(message), self.now())

    def _on_truth(self, message: Odometry) -> None:
        self.picture.hear_truth(_pose(message), self.now())

    def _on_coupling(self, message: JointState) -> None:
        errors = np.array(message.position, dtype=float)
        plausible.demand(errors, plausible.WHEEL_ANGLE, "position")
        self.picture.hear_coupling(errors, self.now())

    def _on_path(self, message: Path) -> None:
        conversions.check_frame(message.header.frame_id, *self._frames)
        poses = message.poses
        places = [poses[i].pose.position for i in thinned(len(poses))]
        self.picture.path.set(_positions(places))

    def _on_plan(self, message: Path) -> None:
        conversions.check_frame(message.header.frame_id, *self._frames)
        poses = message.poses
        places = [poses[i].pose.position for i in thinned(len(poses))]
        self.picture.hear_plan(_positions(places), self.now())

    def _on_obstacles(self, message: MarkerArray) -> str:
        complaints = obstacle_port.hear(self, message, self._obstacles, self._frames)
        return complaints[0] if complaints else ""

    def _draw_obstacles(self) -> None:
        """Where they are now, at constant velocity since they were observed."""
        around = self._obstacles.ellipses(self.now())
        if len(around) or len(self.picture.obstacles.points):
            shown = around.select(np.array(list(thinned(len(around), SHOWN)), dtype=int))
            self.picture.obstacles.set(outlines(shown.centers, shown.semi_axes, shown.angles))

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        conversions.check_frame(message.header.frame_id, *self._frames)
        points = message.points
        places = [
            transform.translation
            for i in thinned(len(points))
            for transform in points[i].transforms[:1]
        ]
        self.picture.hear_reference(_positions(places), self.now())

    def _on_progress(self, message: Float64) -> None:
        if not 0.0 <= message.data <= 1.0:
            raise InputError(f"{message.data} is not within 0 to 1")
        self.picture.hear_progress(message.data, self.now())

    def _on_source(self, message: String) -> None:
        self.picture.active_source = message.data

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        self.picture.stops[message.name] = Condition(_level(message), message.message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        inside = self.get_namespace().rstrip("/") + "/"
        for status in message.status:
            if status.name.startswith(inside) and status.name != self.get_fully_qualified_name():
                self.picture.hear_complaint(
                    status.name, _level(status), status.message, self.now()
                )

    # ---- the page -----------------------------------------------------------------------------

    def serve(self) -> None:
        """Serve what was pressed, and drive while a button is held."""
        now = self.now()
        held_up = now - self._served_at > DEAD_MAN
        self._served_at = now
        for _ in range(EVENTS):
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                break
            if isinstance(event, Pressed):
                self._on_pressed(event.action, now)
            else:
                self._hold.hear(event, now)
        if held_up:
            # What was held while this node could not listen may be long released.
            self._hold.release()
        twist = self._framing.next(self._hold.twist(now, *self.page.speeds))
        self._silent = twist is None
        if twist is not None:
            self._cmd_vel.publish(self._twist_message(twist))
        self._collect(now)
        self._take_in()
        self.picture.sample(now)

    def _twist_message(self, twist: Twist) -> TwistMsg | TwistStamped:
        x, y, turn = twist
        message = TwistMsg(linear=Vector3(x=x, y=y), angular=Vector3(z=turn))
        p = self.settings.value
        if not p.cmd_vel_stamped:
            return message
        stamped = TwistStamped(twist=message)
        stamped.header.stamp = self.stamp()
        stamped.header.frame_id = p.base_frame
        return stamped

    def _on_pressed(self, action: str, now: float) -> None:
        if action == "clear":
            self.picture.odom_trail.clear()
            self.picture.truth_trail.clear()
        elif action in ("stop", "reset"):
            self._hold.release()
            # A reset ends the search for nodes to stop, and the other way round.
            self._end_calls()
            self._calls = (action, Calls(self, action, self.get_namespace()), now + CALLING)
        else:
            self._call_path(f"path_interpolator/{action}")

    def _end_calls(self) -> None:
        if self._calls is not None:
            self._calls[1].close()
            self._calls = None

    def _call_path(self, name: str) -> None:
        if not self._path_clients[name].service_is_ready():
            self.picture.note = f"{name} is not there"
            return
        self._answering[name] = self._path_clients[name].call_async(Trigger.Request())
        self.picture.note = f"{name} ..."

    def _collect(self, now: float) -> None:
        """Take in answers; a stop also calls nodes that turn up a little later."""
        if self._calls is not None:
            action, calls, until = self._calls
            calls.look()
            answers = [
                _answer(name.rpartition("/")[2], answer) for name, answer in calls.answers.items()
            ]
            self.picture.note = f"{action}: {', '.join(answers) or 'no node found yet'}"
            if now > until:
                self._end_calls()
        for name, future in list(self._answering.items()):
            if future.done():
                del self._answering[name]
                answer = future.result()
                self.picture.note = _answer(name, (answer.success, answer.message))

    def draw(self) -> None:
        """Draw a frame, if somebody looks."""
        watched = self.page.watched
        self._listen(watched)
        if watched:
            self._take_in()
            self._draw_obstacles()
            self.page.draw(self.picture, self.now())

    def survey(self) -> None:
        """Look who is there."""
        self.picture.keep_stops(nodes_that_move(self, self.get_namespace()))
        self.picture.services = frozenset(
            name for name, client in self._path_clients.items() if client.service_is_ready()
        )

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        return DiagnosticStatus.OK, "running", [("page", self.page.address)]

    def begin_shutdown(self, reason: str) -> None:
        """Let go of what is held, for good; zeros follow."""
        self._events = queue.SimpleQueue()
        self._hold.release()

    @property
    def finished(self) -> bool:
        """Whether the zeros are sent."""
        return self._silent

    @property
    def patience(self) -> float:
        """How long that may take [s]."""
        return 1.0

    def destroy_node(self) -> None:
        """End the page too."""
        self.page.close()
        super().destroy_node()


def _answer(name: str, answer: tuple[bool, str] | None) -> str:
    """What a service said, in words; None while it has not."""
    if answer is None:
        return f"{name} does not answer"
    success, message = answer
    return f"{name} done" if success else f"{name} REFUSED ({message})"


def _pose(message: Odometry) -> Pose:
    position = message.pose.pose.position
    plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
    return position.x, position.y, conversions.yaw(message.pose.pose.orientation)


def _positions(places: list[Any]) -> Array:
    points = np.array([(place.x, place.y) for place in places], dtype=float).reshape(-1, 2)
    plausible.demand(points, plausible.LENGTH, "positions")
    return points


def _level(status: DiagnosticStatus) -> int:
    """0 good, 1 warning, 2 error; stale counts as an error."""
    return min(int.from_bytes(status.level, "little"), 2)


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros viewer`."""
    if not availability.is_available():
        print(f"cannot start: {availability.HINT}", file=sys.stderr)
        return 1
    return run(ViewerNode, args)
