"""CPU time of the stream while the tool is led along a path: of a preview, and of the node."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from std_msgs.msg import Float64

from omniman_ros import arm_conversions, conversions
from omniman_ros.cli.bench_cpu import cpu_shares
from omniman_ros.cli.children import Children, signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import Setup, tasks
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import PLATFORM_AXES, BodyModel
from omniman_ros.core.body.tool_planner import ToolPlan
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.core.path.pace import Demand, Pace
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.motions.body_port import CORRECTED, JOINTS, PLATFORM, part
from omniman_ros.nodes.motions.parameters import PathInterpolatorParameters
from omniman_ros.nodes.motions.tool_stream import ToolStream
from omniman_ros.nodes.path_interpolator import PathInterpolatorNode

Array = NDArray[np.float64]

NAMES = (
    "path_interpolator", "platform_controller", "simulated_drive", "arm_streamer", "simulated_ur",
)  # fmt: skip
OFF = np.array([0.004, -0.003, 0.005])
"""Of the platform from its reference, so that there is something to correct [m, m, rad]."""
ARM_RATE, ODOM_RATE = 50.0, 100.0
"""Previews of the arm, those with the platform among them, at most; and poses of odom [1/s]."""
PREVIEWS = 100
"""Of each kind in a block."""
SETTLE = 2.0
"""Discovery among the nodes; and what a path's begin takes [s]."""
BEGIN = 30.0
"""How long a planned path may wait until it begins [s]."""
PATIENT = (
    "timeouts.wheel_states:=2.0", "firmware.watchdog:=2.0", "odom_timeout:=2.0",
    "joint_trajectory.states_timeout:=2.0", "joint_trajectory.following_error:=1.0",
    "scaling_timeout:=2.0", "ur.feedback_timeout:=1.0", "ur.following_error:=1.0",
    "ur.read_timeout:=0.2", "safety.deadline:=0.05", "drive.dead_wheel:=drive_on",
)  # fmt: skip
"""Nodes may wait for their turn on a busy machine: what is measured is CPU time."""


class BareStream:
    """What the node computes for a preview, without the node.

    Args:
        parameters: Of the node.
        plan: What is driven, from time 0 on.
    """

    def __init__(self, parameters: PathInterpolatorParameters, plan: ToolPlan) -> None:
        p = parameters
        limits = BodyLimits.of_body(p.core, p.arm)
        self._core = JointInterpolator(limits, p.joint_trajectory)
        self._pace = Pace(lambda times: Demand.none(len(times)), TICK)
        assert self._core.take(JointProposal(plan.curve, None, None), 0.0)
        self._tool = ToolStream(
            BodyModel(p.mount), plan, p.tool_path, p.arm.each("velocity")
        )  # fmt: skip
        self._arm = arm_conversions.joint_reference_message(
            p.arm.joints, round(CORRECTED / TICK) + 1, TICK
        )
        self._both = arm_conversions.joint_reference_message(
            p.arm.joints, int(p.horizon / TICK) + 1, TICK
        )
        self._platform = conversions.reference_message(
            p.odom_frame, int(p.horizon / TICK) + 1, TICK
        )
        self._pose, self._stamp = Pose(), Time()
        self._heard = 0.0

    def hear(self) -> None:
        """Take in the next pose of odom."""
        self._heard += 1.0 / ODOM_RATE
        wanted = self._core.sample(np.array([self._pace.motion(self._heard)]))[0][0, :3]
        self._tool.correction.hear(self._heard, wanted + OFF, wanted)

    def planned(self, time: float, horizon: float) -> Array:
        """All axes (k, 9) as planned, without any correction."""
        return self._core.sample(_ticks(time, horizon))[0]

    def window(self, time: float, horizon: float) -> tuple[Window, Array]:
        """All axes as they are sent, and the tool's pose (4, 4)."""
        times = _ticks(time, horizon)
        wide = np.concatenate([times[:1] - TICK, times, times[-1:] + TICK])
        paced = self._pace.sample(wide)
        along = self._core.along(paced.motion)
        motion = paced.apply(*self._core.sample(paced.motion))
        tool: Array = self._tool.plan.tool(along[1:2])[0]
        return Window(times, *self._tool.window(wide, along, float(paced.rate[0]), *motion)), tool

    def filled(self, time: float, horizon: float, platform: bool) -> None:
        """The same in its messages."""
        window, tool = self.window(time, horizon)
        arm_conversions.fill_pose(self._pose, tool)
        message = self._both if platform else self._arm
        arm_conversions.fill_joint_reference(message, self._stamp, part(window, JOINTS))
        if platform:
            conversions.fill_reference(self._platform, self._stamp, part(window, PLATFORM))


def previews(
    parameters: PathInterpolatorParameters, robot: str, plan: ToolPlan, blocks: int
) -> dict[str, Any]:
    """CPU time of previews [us], of the arm alone and of both, and of a tick of 8 ms.

    Args:
        parameters: Of the node.
        robot: A name, or the path of a file.
        plan: What is driven.
        blocks: Of previews; the best counts.
    """
    bare, horizon = BareStream(parameters, plan), parameters.horizon
    spread = plan.curve.duration / PREVIEWS

    def each(work: Callable[[float], object]) -> float:
        """Best CPU time of a call [us], at instants all along the plan."""
        times = []
        for _ in range(blocks):
            begin = time.process_time()
            for k in range(PREVIEWS):
                work(spread * k)
            times.append(time.process_time() - begin)
        return 1e6 * min(times) / PREVIEWS

    figures: dict[str, Any] = {"hear_odom": each(lambda _: bare.hear())}
    for name, reach, platform in (("arm", CORRECTED, False), ("both", horizon, True)):
        figures[name] = {
            "planned": each(lambda at, reach=reach: bare.planned(at, reach)),
            "corrected": each(lambda at, reach=reach: bare.window(at, reach)),
            "and_filled": each(lambda at, r=reach, p=platform: bare.filled(at, r, p)),
        }
    published = _published(robot, parameters, plan, each)
    for name, value in published.items():
        figures[name]["and_published"] = value
    alone = ARM_RATE - 1.0 / parameters.period
    figures["tick"] = {
        kind: TICK
        * (figures["both"][kind] / parameters.period + alone * figures["arm"][kind]
           + ODOM_RATE * figures["hear_odom"])
        for kind in ("corrected", "and_filled", "and_published")
    }  # fmt: skip
    return figures


def _published(
    robot: str,
    parameters: PathInterpolatorParameters,
    plan: ToolPlan,
    each: Callable[[Callable[[float], object]], float],
) -> dict[str, float]:
    """CPU time of previews by the node itself, which nobody hears [us]."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    try:
        node = PathInterpolatorNode(
            context=context, parameter_overrides=[Parameter("robot", value=robot)]
        )
        try:
            return _published_by(node, parameters, plan, each)
        finally:
            node.begin_shutdown("measured")
            node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def _published_by(
    node: PathInterpolatorNode,
    parameters: PathInterpolatorParameters,
    plan: ToolPlan,
    each: Callable[[Callable[[float], object]], float],
) -> dict[str, float]:
    p, body = parameters, node.body
    node.get_logger().set_level(LoggingSeverity.WARN)
    node.watch.hear_source("path")  # as if the controller were there
    tool = ToolStream(BodyModel(p.mount), plan, p.tool_path, p.arm.each("velocity"))
    body.follow(tool)
    tool.correction.hear(node.now(), OFF, np.zeros(len(PLATFORM_AXES)))
    result = {
        "arm": each(lambda _: body.publish(CORRECTED, platform=False)),
        "both": each(lambda _: body.publish(p.horizon)),
    }
    if body.idle:
        raise CommandError(f"the node gave up: {body.last}")
    return result


def path_message(poses: Array) -> Path:
    """Poses (k, 4, 4) of the tool in odom as a path."""
    path = Path()
    path.header.frame_id = "odom"
    for pose in poses:
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        path.poses.append(stamped)
    return path


def _ticks(time: float, horizon: float) -> Array:
    first = np.floor(time / TICK + 1e-6)
    ticks: Array = TICK * (first + np.arange(int(horizon / TICK) + 1, dtype=float))
    return ticks


def shares(robot: str, angles: Sequence[float], poses: Array, seconds: float) -> dict[str, Any]:
    """Share of a core of the running nodes, at rest and while the tool is led along a path.

    Args:
        robot: A name, or the path of a file.
        angles: (6,) of the arm at rest [rad].
        poses: (k, 4, 4) of the tool in odom, from where it is then; long enough.
        seconds: For so long, each [s].

    Raises:
        CommandError: The nodes do not come up, or the path is not driven.
    """
    initial = f"simulated_arm.initial:={[float(angle) for angle in angles]}"
    setup = Setup(robot=robot, only=NAMES, params=(initial, *PATIENT))
    log = NodeLog()
    children = Children(tasks(setup), on_line=log)
    with signals_to(children.interrupt):
        try:
            with children, Session("omniman_bench") as session:
                return _Led(session, children).measured(path_message(poses), seconds)
        except CommandError:
            log.show()
            raise


class _Led:
    """The running robot, seen from the benchmark."""

    def __init__(self, session: Session, children: Children) -> None:
        self._session, self._children = session, children
        self._progress = 0.0
        self._is_measured = False
        self._previews = 0
        node = session.node
        node.create_subscription(Float64, "path_progress", self._on_progress, 10)
        node.create_subscription(PoseStamped, "tool_pose", self._on_tool, 10)
        node.create_subscription(PoseStamped, "tool_reference", self._on_reference, 50)
        self._paths = node.create_publisher(Path, "tool_path", 10)

    def _on_progress(self, message: Float64) -> None:
        self._progress = message.data

    def _on_tool(self, message: PoseStamped) -> None:
        self._is_measured = True

    def _on_reference(self, message: PoseStamped) -> None:
        self._previews += 1

    def _wait(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        def checked() -> bool:
            self._children.check()
            return condition()

        if not self._session.wait(checked, timeout):
            raise CommandError(f"{what} within {timeout:g} s")

    def _serve(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._children.check()
            self._session.spin(0.05)

    def measured(self, path: Path, seconds: float) -> dict[str, Any]:
        """The shares; see above."""
        pids = {name: self._children.pid(name) for name in NAMES}
        self._wait(lambda: self._is_measured, DISCOVERY, "no tool_pose")
        self._wait(lambda: self._paths.get_subscription_count() > 0, DISCOVERY, "no tool_path")
        self._serve(SETTLE)
        idle = cpu_shares(pids, lambda: self._serve(seconds))
        self._paths.publish(path)
        self._wait(lambda: self._progress > 0.0, BEGIN, "the path does not begin")
        self._serve(min(SETTLE, seconds))
        before, begin = self._previews, time.monotonic()
        driving = cpu_shares(pids, lambda: self._serve(seconds))
        rate = (self._previews - before) / (time.monotonic() - begin)
        if not rate > 0.0 or self._progress >= 1.0:
            raise CommandError(f"the path was not driven all the time: {self._progress:.0%} of it")
        return {
            "idle": idle, "driving": driving, "previews_per_s": rate,
            "cpu_per_tick_us": 1e6 * TICK * driving["path_interpolator"],
        }  # fmt: skip
