"""Trajectories of the whole body: platform and arm on one time base, in previews of both."""

from collections.abc import Callable

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.joint_points import JointPlanner, JointPoints
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.window import Window
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.nodes.trajectory_interfaces.joint_interface import JointInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_outputs import WholeBodyOutput
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.nodes.trajectory_interfaces.pending_motion import PendingMotion
from omniman_ros.nodes.trajectory_interfaces.tool_stream import ToolPosePublisher, ToolStream

MIN_CORRECTION_PERIOD = 0.018
"""Shortest period of corrected previews of the arm between those of both parts [s]."""


class WholeBodyInterface(JointInterface):
    """Trajectories of odom_x, odom_y, odom_t and the arm's joints.

    Args:
        context: Services of the node.
        core: Interpolator of the nine axes.

    Attributes:
        pending: Motion that waits for the robot.
        limit_scale: Fraction of the platform's limits that dead wheels and the posture leave.
    """

    def __init__(self, context: MotionContext, core: JointInterpolator) -> None:
        super().__init__(context, core, WholeBodyOutput(context))
        self.pending = PendingMotion(
            context, self.log, lambda: context.conflict(self), self.blocking_reason
        )
        self.limit_scale = 1.0
        self._tool: ToolStream | None = None
        self._corrected_at = float("-inf")
        self._tool_reference = ToolPosePublisher(
            self._node, "tool_reference", context.options.frames.odom.odom_frame
        )

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Set new parameters, which apply from the next trajectory on."""
        limits = WholeBodyLimits.of_whole_body(new.core, new.arm)
        self.core.planner = JointPlanner(limits, new.joint_trajectory, TICK)
        if self._tool is not None:
            self._tool.correction.options = new.tool_path

    @property
    def max_pace(self) -> float:
        """Highest pace at which the motion may be driven, 0 to 1."""
        if self.idle:
            return 1.0
        return min(self.limit_scale, 1.0 if self._tool is None else self._tool.max_pace)

    # ---- trajectories -------------------------------------------------------------------------

    def trajectory(self, message: JointTrajectory) -> str:
        """Start a trajectory, or let it wait for the robot; see the base class."""
        points = self.points(message)
        self._context.start_delay(message.header.stamp)
        if self._tool is not None and not self.idle:
            return "a path of the tool is under way; ~/cancel ends it"
        return self.pending.accept(lambda: self._start(points, message))

    def _start(self, points: JointPoints, message: JointTrajectory) -> None:
        delay = self._context.start_delay(message.header.stamp)
        self.start(self._unwrapped(points), delay)

    def _unwrapped(self, points: JointPoints) -> JointPoints:
        """Shift the heading by whole revolutions so that it starts near the robot's heading."""
        if self.idle:
            heading = self.rest_position()[HEADING_COLUMN]
        else:
            now = np.array([self._context.time_base.now()])
            heading = self.core.sample(now)[0][0, HEADING_COLUMN]
        return points.turned_near(HEADING_COLUMN, float(heading))

    @property
    def is_pending(self) -> bool:
        """Whether the motion that was accepted last still waits to be started."""
        return bool(self.pending)

    def discard_pending(self) -> bool:
        """Discard the motion that waits, and return whether there was one."""
        return self.pending.discard()

    def start_pending(self) -> str:
        """Start the waiting motion if possible; return why it is refused, or an empty string."""
        return self.pending.start()

    def blocking_reason(self) -> str:
        """Return why no motion can start yet, or an empty string."""
        options, context = self._context.options, self._context
        why = context.arm_feed.blocking_reason(options.joint_trajectory, idle=self.idle)
        if why or not self.idle:
            return why
        why = context.odom.blocking_reason(options.odom_timeout)
        return why or context.control_wait_reason()

    # ---- state of the axes --------------------------------------------------------------------

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return each part's references at its own time of measurement; see the base class."""
        if self.idle:
            return None
        platform = self._desired_at(self._context.odom.time)
        arm = self._desired_at(self._context.arm_feed.time)
        x, v, a = (
            np.concatenate([p[PLATFORM_COLUMNS], q[JOINT_COLUMNS]])
            for p, q in zip(platform, arm, strict=True)
        )
        return x, v, a

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (9,), with odom's heading as it is."""
        odom, arm = self._context.odom, self._context.arm_feed.state()
        if odom.pose is None or arm is None:
            return None
        return np.concatenate([odom.pose, arm[0]]), np.concatenate([odom.velocity, arm[1]])

    def rest_position(self) -> Array:
        """Return the positions (9,) at which platform and arm are at rest [m, m, rad, ...]."""
        tolerance = self._context.options.joint_trajectory.start_tolerance
        arm = self._context.arm_feed.start_position(tolerance)
        assert self._context.odom.pose is not None and arm is not None
        return np.concatenate([self._context.odom.pose, arm])

    # ---- paths of the tool --------------------------------------------------------------------

    def follow_tool_path(self, tool: ToolStream) -> None:
        """Start a path of the tool that was planned from the robot's present position."""
        self.log.accept(replaces_pending=False)
        self._take(lambda _: JointProposal(tool.plan.curve, None, None), 0.0)
        self._tool = tool
        self._announce(f"{tool.plan.length:.2f} m of the tool in {tool.plan.curve.duration:.2f} s")

    def update_pose(self, pose: Array, at: float) -> None:
        """Correct the arm for the platform's error as soon as it is measured.

        Args:
            pose: (3,) measured pose of the platform in odom [m, m, rad].
            at: Time of the measurement on the node's clock [s].
        """
        tool, pace = self._tool, self._context.time_base.pace
        if self.idle or tool is None or at <= tool.correction.time:
            return  # a controller that was held up repeats a measurement
        if not self.output.is_covered(self._node.now()):
            return  # the next tick gives the motion up
        reference = self.core.sample(np.array([pace.motion(at)]))[0][0, PLATFORM_COLUMNS]
        if deviation := tool.correct(at, pose, reference):
            self.give_up(f"the platform is {deviation} off its path", brake=True)
        elif self._node.now() - self._corrected_at >= MIN_CORRECTION_PERIOD:
            self.publish(self._context.options.horizon, platform=False)

    def publish(self, horizon: float, *, platform: bool = True) -> None:
        """Publish previews that are `horizon` long [s], of both parts or of the arm alone."""
        if self.idle:
            return
        if self._tool is None:
            super().publish(horizon)
            return
        time_base = self._context.time_base
        times = time_base.sample_times(horizon)
        try:
            stretch = self._tool.corrected(times, time_base.pace, self.core)
        except InputError as error:
            self.give_up(str(error), brake=True)
            return
        self._tool_reference.send(float(times[0]), stretch.tool)
        self._corrected_at = self._node.now()
        if platform:
            self.output.send(stretch.window)
        else:
            self.output.send_arm(stretch.window.columns(JOINT_COLUMNS))

    # ---- hooks --------------------------------------------------------------------------------

    def _take(
        self, propose: Callable[[float], JointProposal], planning_time: float
    ) -> JointProposal:
        """Start a motion, which is one of the tool only if that is said afterwards."""
        proposal = super()._take(propose, planning_time)
        self._tool = None
        return proposal

    def _stop_window(self, now: float) -> Window | None:
        """Return the stretch that leads to rest, on which the arm keeps its present correction."""
        window = super()._stop_window(now)
        return window if window is None or self._tool is None else self._tool.offset(window)
