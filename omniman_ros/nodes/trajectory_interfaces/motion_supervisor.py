"""Supervision of the motions of the node: what ends one that the robot can no longer follow."""

from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.nodes.trajectory_interfaces.body_interface import BodyInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext
from omniman_ros.nodes.trajectory_interfaces.motion_interface import MotionInterface
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import ScalingInterface
from omniman_ros.nodes.trajectory_interfaces.path_interface import PathInterface


class MotionSupervisor:
    """Gives motions up whose robot is stopped, silent, overruled or too far from its reference.

    A motion brakes on its path where its receivers still listen. Receivers that are stopped, or
    have been without a preview, come to rest by themselves.
    """

    def __init__(
        self,
        context: BodyContext,
        scaling: ScalingInterface,
        period: float,
        whole_body: BodyInterface,
        path: PathInterface | None = None,
        arm: MotionInterface | None = None,
    ) -> None:
        self._context, self._node, self._scaling = context, context.node, scaling
        self._period, self._path, self._whole_body = period, path, whole_body
        self._with_arm = (whole_body,) if arm is None else (arm, whole_body)

    def check_control(self) -> None:
        """Give up motions whose robot is stopped or no longer follows."""
        monitor = self._context.stream_monitor
        why = monitor.loss_reason(self._node.now())
        if why:
            self._give_up_platform(why, brake=not monitor.stop_reason)
        for motion in self._with_arm:
            self._check_arm(motion)

    def _give_up_platform(self, why: str, *, brake: bool) -> None:
        """Give up the motions that move the platform; see `MotionInterface.give_up`."""
        if self._path is not None:
            self._path.give_up(why)
        self._whole_body.give_up(why, brake=brake)

    def _check_arm(self, motion: MotionInterface) -> None:
        """Give a motion up whose previews the arm does not get, or that it does not report on."""
        context, silence = self._context, self._context.arm_feed.silence
        if motion.idle:
            return
        if context.stream_monitor.stop_reason:
            motion.give_up(context.stream_monitor.stop_reason, brake=False)
        elif not motion.output.is_covered(self._node.now()):
            motion.give_up("no preview was sent in time", brake=False)
        elif silence > context.options.joint_trajectory.states_timeout:
            motion.give_up(f"no arm/joint_states for {silence:.2f} s", brake=True)

    def limit_pace(self, max_pace: float) -> None:
        """Limit the pace; a motion of platform and arm waits on its path while odom is late."""
        waits = self._is_platform_silent
        self._context.time_base.limit_pace(0.0 if waits else max_pace, at_once=waits)

    @property
    def _is_platform_silent(self) -> bool:
        context = self._context
        return not self._whole_body.idle and context.odom.age > context.options.odom_pause

    def check_arm(self) -> None:
        """Give up motions whose arm is too far from its reference; halt one without platform."""
        max_error = self._context.options.joint_trajectory.following_error
        for motion in self._with_arm:
            error = "" if motion.idle else self._context.arm_feed.following_error(max_error)
            if error:
                motion.give_up(error, brake=True)
        if self._is_platform_silent and self._context.time_base.pace.target > 0.0:
            self.limit_pace(0.0)
            self._context.publish_all(self._context.options.horizon)

    def check_time(self, since_tick: float) -> None:
        """Give up motions that a time [s] ends, and let it pass for inputs."""
        context = self._context
        if since_tick < -TIME_JUMP:
            self._restart()
        else:
            self._check_platform(since_tick)
        # While this node is held up, the other nodes are not silent.
        elapsed = min(max(since_tick, 0.0), 2.0 * self._period)
        for feed in (context.odom, self._scaling, context.arm_feed):
            feed.pass_time(elapsed)
        if self._scaling.silence > context.options.scaling_timeout:
            why = f"no arm/speed_scaling for {self._scaling.silence:.2f} s"
            for motion in self._with_arm:
                motion.give_up(why, brake=True)

    def _check_platform(self, since_tick: float) -> None:
        """Give up motions whose previews the platform does not get, or that it is silent about."""
        context = self._context
        if self._node.now() > context.platform_previews.covered_until:
            why, can_brake = f"no preview for {since_tick:.2f} s", False
        elif context.odom.silence > context.options.odom_timeout:
            why, can_brake = f"no odom for {context.odom.silence:.2f} s", True
        else:
            return
        self._give_up_platform(why, brake=can_brake)

    def _restart(self) -> None:
        """Forget all that was received, because time went back."""
        why = "time went back"
        self._give_up_platform(why, brake=False)
        for motion in self._with_arm:
            motion.give_up(why, brake=False)
        self._context.stream_monitor.restart(self._node.now())
        self._context.odom.forget()
        self._context.arm_feed.forget()
