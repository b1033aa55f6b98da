"""Trajectories of the whole body: platform and arm on one time base, in previews of both."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import PLATFORM_AXES
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.path.joint_interpolator import JointProposal
from omniman_ros.core.path.joint_points import JointPlanner, JointPoints
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.motions.host import Host
from omniman_ros.nodes.motions.joint_port import JointPort
from omniman_ros.nodes.motions.parameters import PathInterpolatorParameters
from omniman_ros.nodes.motions.tool_stream import ToolOutput, ToolStream
from omniman_ros.nodes.motions.waiting import Waiting

Array = NDArray[np.float64]

HEADING = PLATFORM_AXES.index("odom_t")
PLATFORM, JOINTS = slice(None, len(PLATFORM_AXES)), slice(len(PLATFORM_AXES), None)
CORRECTED = 0.018
"""Least period of previews of the arm between those of the platform [s]."""


class BodyPort(JointPort):
    """Trajectories of odom_x, odom_y, odom_t and the arm's joints.

    Attributes:
        waiting: The motion that waits for the platform.
        share: Of the platform's limits that is left where a wheel is dead.
    """

    def __init__(self, host: Host) -> None:
        super().__init__(host, BodyLimits.of_body(host.options.core, host.options.arm))
        self.waiting = Waiting(self._node.now, host.watch)
        self.share = 1.0
        self._tool: ToolStream | None = None
        self._corrected = float("-inf")
        self._arm_at: Array | None = None
        self._offset: Array = np.zeros(len(self.names) - len(PLATFORM_AXES))
        self._tool_out = ToolOutput(self._node, "tool_reference", host.options.odom_frame)

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Take new parameters; they count from the next trajectory."""
        limits = BodyLimits.of_body(new.core, new.arm)
        self.core.planner = JointPlanner(limits, new.joint_trajectory, TICK)
        if self._tool is not None:
            self._tool.correction.options = new.tool_path

    @property
    def pace(self) -> float:
        """How fast it may be driven, 0 to 1."""
        if self.idle:
            return 1.0
        return self.share if self._tool is None else min(self.share, self._tool.pace)

    def trajectory(self, message: JointTrajectory) -> str:
        """Begin a trajectory, or let it wait for the platform; see the base class."""
        points = self.points(message)
        self.delay(message.header.stamp)
        if self._tool is not None and not self.idle:
            return "a path of the tool is under way; ~/cancel ends it"
        if self.waiting:
            self._over("replaced", self._claimed)
        self._claim()
        self.waiting.put(lambda: self._begin_now(points, message))
        return self.try_waiting()

    def _waits(self) -> bool:
        return bool(self.waiting)

    def cancel(self, motion: int) -> None:
        """Bring a motion to rest on its path; see the base class."""
        if motion == self._claimed and self.drop():
            return
        super().cancel(motion)

    def drop(self) -> bool:
        """Forget the motion that waits; returns whether there was one."""
        dropped = self.waiting.drop()
        if dropped:
            self._over("cancelled", self._claimed)
        return dropped

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Those of each part at the instant at which it was measured; see the base class."""
        if self.idle:
            return None
        platform = self._desired_at(self._host.odom.time)
        joints = self._desired_at(self._host.arm_feed.time)
        x, v, a = (
            np.concatenate([one[PLATFORM], other[JOINTS]])
            for one, other in zip(platform, joints, strict=True)
        )
        return x, v, a

    def actual(self) -> tuple[Array, Array] | None:
        """Measured positions and velocities (9,); the heading is within half a turn of odom's."""
        odom, arm = self._host.odom, self._host.arm_feed.state()
        if odom.pose is None or arm is None:
            return None
        return np.concatenate([odom.pose, arm[0]]), np.concatenate([odom.velocity, arm[1]])

    def _begin_now(self, points: JointPoints, message: JointTrajectory) -> None:
        self.begin(self._unwrapped(points), self.delay(message.header.stamp))

    def _unwrapped(self, points: JointPoints) -> JointPoints:
        """The same with the heading shifted by whole turns to where the robot looks."""
        if HEADING not in points.columns:
            return points
        column = points.columns.index(HEADING)
        motion = None if self.idle else self.core.sample(np.array([self._host.together.now()]))
        here = self.here()[HEADING] if motion is None else motion[0][0, HEADING]
        turns = round((here - points.positions[0, column]) / math.tau)
        positions = points.positions.copy()
        positions[:, column] += turns * math.tau
        return replace(points, positions=positions)

    def try_waiting(self) -> str:
        """Begin what waits, if that can be; returns why it never will."""
        why, waits = self.waiting.attempt(self._obstacle(), self.not_yet)
        if waits:
            self.last = f"a trajectory waits: {waits}"
        if why:
            self.last = f"a trajectory was refused: {why}"
            self._over(why, self._claimed)
        return why

    def _obstacle(self) -> str:
        return self._host.watch.obstacle or self._host.busy(self)

    def not_yet(self) -> str:
        """Why no motion can begin yet, or an empty string."""
        options, host = self._host.options.joint_trajectory, self._host
        why = host.arm_feed.not_yet(options.states_timeout, options.start_tolerance, self.idle)
        if why or not self.idle:
            return why
        why = host.odom.not_yet(host.options.odom_timeout)
        waits = host.watch.wait(self._node.now()) > 0.0
        return why or ("control was lost a moment ago" if waits else "")

    def here(self) -> Array:
        """Where (9,) platform and arm are at rest [m, m, rad, ...]."""
        arm = self._host.arm_feed.place(self._host.options.joint_trajectory.start_tolerance)
        assert self._host.odom.pose is not None and arm is not None
        return np.concatenate([self._host.odom.pose, arm])

    def _began(self, *, from_rest: bool) -> None:
        host, self._tool = self._host, None
        if from_rest:
            host.arm_feed.begin()
            host.odom.silent = 0.0
            host.arm_previews.covered = host.platform_previews.covered = float("inf")
        host.watch.begin(self._node.now())

    # ---- paths of the tool --------------------------------------------------------------------

    def follow(self, tool: ToolStream) -> None:
        """Begin a path of the tool that was planned from here."""
        self._claim()
        self._take(lambda lead: JointProposal(tool.plan.curve, None, None), 0.0)
        self._tool = tool
        self._announce(f"{tool.plan.length:.2f} m of the tool in {tool.plan.curve.duration:.2f} s")

    def hear_pose(self, pose: Array, at: float) -> None:
        """Take the platform's error out of the tool's pose, as soon as it is measured.

        Args:
            pose: (3,) of the platform [m, m, rad].
            at: When it was measured [s].
        """
        tool, pace = self._tool, self._host.together.pace
        if self.idle or tool is None or at <= tool.correction.time:
            return  # a controller that was held up says an instant twice
        wanted = self.core.sample(np.array([pace.motion(at)]))[0][0, :3]
        tool.correction.hear(at, pose, wanted)
        if tool.correction.share > 1.0:
            x, y, theta = tool.correction.error
            off = f"{math.hypot(x, y):.3f} m and {theta:.3f} rad"
            self.give_up(f"the platform is {off} off its path", brake=True)
        elif self._node.now() - self._corrected >= CORRECTED:
            self.publish(self._host.options.horizon, platform=False)

    def publish(self, horizon: float, *, platform: bool = True) -> None:
        """Publish previews that reach so far [s], of the arm alone or of both."""
        if self.idle:
            return
        if self._tool is None:
            super().publish(horizon)
            return
        try:
            window = self._tool_window(self._tool, self._host.together.sample_times(horizon))
        except InputError as error:
            self.give_up(str(error), brake=True)
            return
        self._corrected = self._node.now()
        if platform:
            self._send(window)
        else:
            self._send_arm(part(window, JOINTS))

    def _tool_window(self, tool: ToolStream, times: Array) -> Window:
        wide = np.concatenate([times[:1] - TICK, times, times[-1:] + TICK])
        paced = self._host.together.pace.sample(wide)
        along = self.core.along(paced.motion)
        motion = paced.apply(*self.core.sample(paced.motion))
        self._tool_out.send(float(times[0]), tool.plan.tool(along[1:2])[0])
        window = Window(times, *tool.window(wide, along, float(paced.rate[0]), *motion))
        self._offset = window.positions[0, JOINTS] - motion[0][1, JOINTS]
        return window

    def _paced_stop(self, now: float) -> Window | None:
        """The arm keeps what is corrected; see the base class."""
        window = super()._paced_stop(now)
        if window is None or self._tool is None:
            return window
        positions = window.positions.copy()
        positions[:, JOINTS] += self._offset
        return replace(window, positions=positions)

    # ---- what axes there are ------------------------------------------------------------------

    def _came_to_rest(self) -> None:
        self._host.arm_feed.held = self._arm_at
        self._host.watch.end(lost=False)

    def _send(self, window: Window) -> None:
        self._host.platform_previews.send(part(window, PLATFORM))
        self._host.watch.sent(self._node.now())
        self._send_arm(part(window, JOINTS))

    def _send_arm(self, window: Window) -> None:
        self._arm_at = window.positions[0]
        self._host.arm_feed.want(self._arm_at)
        self._host.arm_previews.send(window)

    def give_up(self, why: str, *, brake: bool) -> None:
        """End the motion of platform and arm; see the base class."""
        if not self.idle:
            super().give_up(why, brake=brake)
            self._host.watch.end(lost=True)

    def look(self) -> None:
        """Give it up if the platform is no longer ours to drive: the arm brakes on its path."""
        if not self.idle:
            why = self._host.watch.lost(self._node.now())
            if why:
                self.give_up(why, brake=not self._host.watch.stop)

    def check(self, held_up: float) -> None:
        """Give it up if it cannot be followed; the node was held up for so long [s]."""
        host = self._host
        if self.idle:
            return
        if self._node.now() > host.platform_previews.covered:
            self.give_up(f"no preview for {held_up:.2f} s", brake=False)
        elif host.odom.silent > host.options.odom_timeout:
            self.give_up(f"no odom for {host.odom.silent:.2f} s", brake=True)


def part(window: Window, columns: slice) -> Window:
    """Some of the axes."""
    arrays = (window.positions, window.velocities, window.accelerations)
    return Window(window.times, *(array[:, columns] for array in arrays))
