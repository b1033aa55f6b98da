"""Measurement of the CPU time of streaming a tool path: of one preview, and of the whole node."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseStamped
from nav_msgs.msg import Path
from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from std_msgs.msg import Float64

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.trajectories import fill_reference, reference_message
from omniman_ros.core.arrays import Array
from omniman_ros.lab.bench.harness import RunningNodes, running_nodes
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_AXES, PLATFORM_COLUMNS
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.pace import Demand, Pace
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.window import Window
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlan
from omniman_ros.nodes.path_interpolator import PathInterpolatorNode
from omniman_ros.nodes.trajectory_interfaces.body_interface import MIN_CORRECTION_PERIOD
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.nodes.trajectory_interfaces.tool_stream import ToolStream
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes

NODES = (
    "path_interpolator",
    "platform_controller",
    "simulated_drive",
    "arm_streamer",
    "simulated_ur",
)
"""Nodes whose CPU time is measured."""
PLATFORM_ERROR = np.array([0.004, -0.003, 0.005])
"""Deviation of the platform from its reference, which the arm has to correct [m, m, rad]."""
ARM_RATE = 50.0
"""Highest rate of the arm's previews, including those together with the platform's [Hz]."""
ODOM_RATE = 100.0  # rate of messages on `odom` [Hz]
PREVIEWS = 100  # number of previews of each kind in a block
SETTLING_TIME = 2.0
"""Time allowed for the nodes to discover each other, and for the start of a path [s]."""
START_TIMEOUT = 30.0  # longest time until the robot starts to follow a path, planning included [s]
LENIENT = (
    "timeouts.wheel_states:=2.0",
    "firmware.watchdog:=2.0",
    "odom_timeout:=2.0",
    "odom_pause:=2.0",
    "joint_trajectory.states_timeout:=2.0",
    "joint_trajectory.following_error:=1.0",
    "scaling_timeout:=2.0",
    "ur.feedback_timeout:=1.0",
    "ur.following_error:=1.0",
    "ur.read_timeout:=0.2",
    "safety.deadline:=0.05",
    "drive.dead_wheel:=drive_on",
)
"""Arguments that set long time-outs and wide tolerances of the nodes.

On a busy machine, nodes may be late without harm, as CPU time is measured.
"""


class BareStream:
    """Computes the previews of the node `path_interpolator` without a ROS node."""

    def __init__(self, parameters: PathInterpolatorParameters, plan: ToolPlan) -> None:
        p = parameters
        limits = WholeBodyLimits.of_whole_body(p.core, p.arm)
        self._core = JointInterpolator(limits, p.joint_trajectory)
        self._pace = Pace(lambda times: Demand.none(len(times)), TICK)
        assert self._core.take(JointProposal(plan.curve, None, None), 0.0)
        self._tool = ToolStream(WholeBodyModel(p.mount), plan, p.tool_path, p.arm.each("velocity"))
        self._arm = arm_conversions.joint_reference_message(
            p.arm.joints, round(MIN_CORRECTION_PERIOD / TICK) + 1, TICK
        )
        self._both = arm_conversions.joint_reference_message(
            p.arm.joints, int(p.horizon / TICK) + 1, TICK
        )
        self._platform = reference_message(
            p.frames.odom.odom_frame, int(p.horizon / TICK) + 1, TICK
        )
        self._pose, self._stamp = Pose(), Time()
        self._odom_time = 0.0

    def update_odom(self) -> None:
        """Process the next pose of the platform, which deviates from its reference."""
        self._odom_time += 1.0 / ODOM_RATE
        reference = self._core.sample(np.array([self._pace.motion(self._odom_time)]))[0][0, :3]
        self._tool.correction.update(self._odom_time, reference + PLATFORM_ERROR, reference)

    def planned(self, time: float, horizon: float) -> Array:
        """Return the planned positions of a preview, without the arm's correction.

        Args:
            time: Start of the preview [s].
            horizon: Duration of the preview [s].

        Returns:
            (k, 9) positions of all axes: platform [m, m, rad], joints [rad].
        """
        return self._core.sample(_ticks(time, horizon))[0]

    def window(self, time: float, horizon: float) -> tuple[Window, Array]:
        """Return a preview with the arm's correction.

        Args:
            time: Start of the preview [s].
            horizon: Duration of the preview [s].

        Returns:
            Preview of all axes, and (4, 4) pose of the tool in odom.
        """
        times = _ticks(time, horizon)
        stretch = self._tool.corrected(times, self._pace, self._core)
        return stretch.window, stretch.tool

    def fill_messages(self, time: float, horizon: float, platform: bool) -> None:
        """Compute a preview with the arm's correction, and write it into its ROS messages.

        Args:
            time: Start of the preview [s].
            horizon: Duration of the preview [s].
        """
        window, tool = self.window(time, horizon)
        arm_conversions.fill_pose(self._pose, tool)
        message = self._both if platform else self._arm
        arm_conversions.fill_joint_reference(message, self._stamp, window.columns(JOINT_COLUMNS))
        if platform:
            fill_reference(self._platform, self._stamp, window.columns(PLATFORM_COLUMNS))


def measure_previews(
    parameters: PathInterpolatorParameters, robot: str, plan: ToolPlan, blocks: int
) -> dict[str, Any]:
    """Measure the CPU time of previews, and compute from it that of a streamed tick of 8 ms.

    Returns:
        CPU times [us] of a preview of the arm (`arm`) and of platform and arm (`both`), of a
        message on `odom` (`receive_odom`) and of a tick (`tick`).
    """
    bare, horizon = BareStream(parameters, plan), parameters.horizon
    spread = plan.curve.duration / PREVIEWS

    def each(work: Callable[[float], object]) -> float:
        """Return the CPU time of a call [us], averaged over instants along the whole plan."""
        times = []
        for _ in range(blocks):
            begin = time.process_time()
            for k in range(PREVIEWS):
                work(spread * k)
            times.append(time.process_time() - begin)
        return 1e6 * min(times) / PREVIEWS

    figures: dict[str, Any] = {"receive_odom": each(lambda _: bare.update_odom())}
    for name, span, platform in (("arm", MIN_CORRECTION_PERIOD, False), ("both", horizon, True)):
        figures[name] = {
            "planned": each(partial(bare.planned, horizon=span)),
            "corrected": each(partial(bare.window, horizon=span)),
            "and_filled": each(partial(bare.fill_messages, horizon=span, platform=platform)),
        }
    published = _measure_published(robot, parameters, plan, each)
    for name, value in published.items():
        figures[name]["and_published"] = value
    arm_only_rate = ARM_RATE - 1.0 / parameters.period
    figures["tick"] = {
        kind: TICK
        * (
            figures["both"][kind] / parameters.period
            + arm_only_rate * figures["arm"][kind]
            + ODOM_RATE * figures["receive_odom"]
        )
        for kind in ("corrected", "and_filled", "and_published")
    }
    return figures


def _measure_published(
    robot: str,
    parameters: PathInterpolatorParameters,
    plan: ToolPlan,
    each: Callable[[Callable[[float], object]], float],
) -> dict[str, float]:
    """Return the CPU time of a preview that the node itself publishes, without subscribers [us].

    Args:
        each: Function that measures the CPU time of a call at instants along the plan [us].
    """
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    try:
        node = PathInterpolatorNode(
            context=context, parameter_overrides=[Parameter("robot", value=robot)]
        )
        try:
            return _measure_published_by(node, parameters, plan, each)
        finally:
            node.begin_shutdown("measured")
            node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def _measure_published_by(
    node: PathInterpolatorNode,
    parameters: PathInterpolatorParameters,
    plan: ToolPlan,
    each: Callable[[Callable[[float], object]], float],
) -> dict[str, float]:
    p, body = parameters, node.motions.whole_body
    node.get_logger().set_level(LoggingSeverity.WARN)
    node.motions.context.stream_monitor.update_source("path")  # in place of a platform controller
    tool = ToolStream(WholeBodyModel(p.mount), plan, p.tool_path, p.arm.each("velocity"))
    body.follow_tool_path(plan, tool)
    tool.correction.update(node.now(), PLATFORM_ERROR, np.zeros(len(PLATFORM_AXES)))
    result = {
        "arm": each(lambda _: body.publish(MIN_CORRECTION_PERIOD, platform=False)),
        "both": each(lambda _: body.publish(p.horizon)),
    }
    if body.idle:
        raise CommandError(f"the node aborted the path: {body.status.text}")
    return result


def path_message(poses: Array) -> Path:
    """Return the message of a path of poses (k, 4, 4) of the tool in odom."""
    path = Path()
    path.header.frame_id = "odom"
    for pose in poses:
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        path.poses.append(stamped)
    return path


def _ticks(time: float, horizon: float) -> Array:
    """Return the times (k,) of the ticks [s] from that at or just before `time` on."""
    first = np.floor(time / TICK + 1e-6)
    ticks: Array = TICK * (first + np.arange(int(horizon / TICK) + 1, dtype=float))
    return ticks


def measure_shares(
    robot: str, angles: Sequence[float], poses: Array, seconds: float
) -> dict[str, Any]:
    """Measure the share of a core that the running nodes use, at rest and along a tool path.

    Args:
        angles: (6,) joint angles of the arm at rest [rad].
        poses: (k, 4, 4) poses of the tool in odom, lengths in metres, starting with the tool's
            pose at rest; following the path must take longer than the measurement.
        seconds: Duration of each of the two measurements [s].
    """
    initial = f"simulated_arm.initial:={[float(angle) for angle in angles]}"
    setup = RobotSetup(robot=robot, only=NODES, params=(initial, *LENIENT))
    with running_nodes(robot_processes(setup)) as nodes:
        return _ToolPathRun(nodes).measure(path_message(poses), seconds)


class _ToolPathRun:
    """Commands a tool path to the running nodes and counts their previews."""

    def __init__(self, nodes: RunningNodes) -> None:
        self._nodes = nodes
        self._progress = 0.0
        self._tool_is_known = False
        self._previews = 0
        node = nodes.session.node
        node.create_subscription(Float64, "path_progress", self._on_progress, 10)
        node.create_subscription(PoseStamped, "tool_pose", self._on_tool, 10)
        node.create_subscription(PoseStamped, "tool_reference", self._on_reference, 50)
        self._paths = node.create_publisher(Path, "tool_path", 10)

    def _on_progress(self, message: Float64) -> None:
        self._progress = message.data

    def _on_tool(self, message: PoseStamped) -> None:
        self._tool_is_known = True

    def _on_reference(self, message: PoseStamped) -> None:
        self._previews += 1

    def measure(self, path: Path, seconds: float) -> dict[str, Any]:
        """Measure the shares at rest and along a path; see :func:`measure_shares`."""
        nodes = self._nodes
        nodes.wait(lambda: self._tool_is_known, DISCOVERY_TIMEOUT, "no tool_pose")
        nodes.wait(
            lambda: self._paths.get_subscription_count() > 0,
            DISCOVERY_TIMEOUT,
            "no subscriber of tool_path",
        )
        nodes.serve(SETTLING_TIME)
        idle = nodes.cpu_shares(NODES, seconds)
        self._paths.publish(path)
        nodes.wait(
            lambda: self._progress > 0.0,
            START_TIMEOUT,
            "the robot did not start to follow the path",
        )
        nodes.serve(min(SETTLING_TIME, seconds))
        before, begin = self._previews, time.monotonic()
        driving = nodes.cpu_shares(NODES, seconds)
        rate = (self._previews - before) / (time.monotonic() - begin)
        if not rate > 0.0 or self._progress >= 1.0:
            raise CommandError(
                f"the robot did not follow the path during the whole measurement: progress "
                f"{self._progress:.0%}"
            )
        return {
            "idle": idle,
            "driving": driving,
            "previews_per_s": rate,
            "cpu_per_tick_us": 1e6 * TICK * driving["path_interpolator"],
        }
