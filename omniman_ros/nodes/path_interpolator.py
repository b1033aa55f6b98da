"""Node `path_interpolator`: paths and trajectories in, streams for platform and arm out."""

import functools
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from omniman_ros import conversions
from omniman_ros.core.control import ControlWatch
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.path.interpolator import RefusedError
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.control_port import ControlPort
from omniman_ros.nodes.motions.arm_feed import ArmFeed
from omniman_ros.nodes.motions.arm_port import ArmPort
from omniman_ros.nodes.motions.body_port import BodyPort
from omniman_ros.nodes.motions.odom_feed import OdomFeed
from omniman_ros.nodes.motions.parameters import PathInterpolatorParameters
from omniman_ros.nodes.motions.path_port import PathPort
from omniman_ros.nodes.motions.previews import arm_previews, platform_previews
from omniman_ros.nodes.motions.scaling_port import ScalingPort
from omniman_ros.nodes.motions.together import Together
from omniman_ros.nodes.motions.tool_port import ToolPort
from omniman_ros.nodes.motions.trajectory_input import TrajectoryInput
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run
from omniman_ros.nodes.stopping import LATCHED
from omniman_ros.nodes.trajectory_action import serve_actions

Array = NDArray[np.float64]

TIME_BACK = 0.1
"""Simulated time that goes back by more than this ends all motions [s]."""


class PathInterpolatorNode(OmnimanNode):
    """What is measured, what moves and what is sent, put together.

    Attributes:
        watch: Who drives the platform, and who is stopped.
        odom, arm_feed: What is measured.
        path, arm, body: What moves: the platform on paths, the arm, and both as one.
        tool: What makes motions of both from paths of the tool.
        together: Their time base.
        platform_previews, arm_previews: What is sent.
        ending: Whether the node ends.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("path_interpolator", **options)
        self.node = self
        self.settings = ParameterSet(self, PathInterpolatorParameters)
        p = self.options
        if 2.0 * p.period > p.horizon:
            raise ParameterError("period", p.period, "more than half of the horizon")
        self.ending = False
        self.watch = ControlWatch(p.restart)
        self.platform_previews = platform_previews(self, p.odom_frame, p.horizon)
        self.arm_previews = arm_previews(self, p.arm.joints, p.horizon)
        self._progress = self.create_publisher(Float64, "path_progress", 10)
        self.path, self.arm, self.body = PathPort(self), ArmPort(self), BodyPort(self)
        self.scaling = ScalingPort(self, self._scaled)
        cores = (self.path.core, self.arm.core, self.body.core)
        self.together = Together(cores, self.now, self.scaling, self._scaling_timeout)
        self._paced = float("-inf")
        self._ticked = self.now()
        self.settings.on_change(self._configure)
        self._make_inputs(p)
        self.every(p.period, self.tick)

    @property
    def options(self) -> PathInterpolatorParameters:
        """Parameters."""
        return self.settings.value

    def _make_inputs(self, p: PathInterpolatorParameters) -> None:
        self.odom = OdomFeed(self, p.odom_frame, self._on_pose)
        self.arm_feed = ArmFeed(
            self, p.arm.joints, lambda: not (self.arm.idle and self.body.idle), self._on_joints
        )
        TrajectoryInput(self, self.arm, self.body)
        self.tool = ToolPort(self, self.body)
        ports = {p.arm_action: self.arm, p.body_action: self.body}
        self.actions = serve_actions(self, ports, p.trajectory_action)
        on_health = self.guarded("wheel_health", self._on_health)
        self.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)
        ControlPort(self, self.watch, self._look)
        for name, request in (
            ("pause", self.together.pause), ("resume", self.together.resume),
            ("cancel", self._cancel),
        ):  # fmt: skip
            self.create_service(Trigger, f"~/{name}", functools.partial(self._serve, request))

    def _configure(self, new: PathInterpolatorParameters) -> None:
        new.core.planner()  # what it would refuse, it refuses now
        self.arm.configure(new.arm, new.joint_trajectory)
        self.body.configure(new)
        self.path.core.parameters = new.core
        for action in self.actions:
            action.options = new.trajectory_action
        self.watch.silence = new.restart

    def _scaling_timeout(self) -> float:
        return self.options.scaling_timeout

    # ---- inputs -------------------------------------------------------------------------------

    def _on_pose(self, pose: Array, at: float) -> None:
        self.body.hear_pose(pose, at)

    def _on_joints(self) -> None:
        self.arm.compare()
        self.body.compare()

    def _on_health(self, message: DiagnosticStatus) -> None:
        """Drive with the limits that the controller has left, where a wheel is dead."""
        share, core = conversions.limits_share(message), self.path.core
        if share > core.share:  # the controller was reset: it wants a silence
            self.watch.restart(self.now())
        if share != core.share:
            self.body.share = share
            core.scale(share, self.together.now())
            self.tick()

    def _serve(
        self, request: Callable[[], None], _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            request()
        except RefusedError as error:
            response.success, response.message = False, str(error)
        else:
            self.tick()
            response.success, response.message = True, self.together.state.value
        return response

    def _cancel(self) -> None:
        waiting = (self.path.waiting, self.path), (self.body, self.body), (self.tool, self.tool)
        waited = [port for what, port in waiting if what.drop()]
        for port in waited:
            port.last = "cancelled"
        if not self.together.idle or not waited:
            self.together.cancel()

    # ---- what the ports ask of the node -------------------------------------------------------

    def busy(self, port: object) -> str:
        """Why a motion of the platform cannot begin beside those of other ports; or nothing."""
        if port is not self.body:
            rival = "" if self.body.idle else "a motion of the whole body"
        elif not self.path.idle:
            rival = "a path"
        else:
            rival = "" if self.arm.idle else "a trajectory of the arm"
        return rival and f"{rival} is under way; ~/cancel ends it"

    def cover(self, horizon: float) -> None:
        """Publish previews that reach so far [s], of all that moves."""
        for port in (self.path, self.arm, self.body):
            if not port.idle:
                port.publish(horizon)

    def begun(self) -> None:
        """Send the first preview of a new motion."""
        self.together.release()
        self.tick()

    # ---- cycle --------------------------------------------------------------------------------

    def _scaled(self) -> None:
        """Slow down at once; what comes in a burst waits for the next tick."""
        if not self.together.idle and self.now() - self._paced >= TICK:
            self._paced = self.now()
            self.tick()

    def _look(self) -> None:
        """Give up what is stopped or has lost control, each for its own reasons."""
        self.path.look()
        self.body.look()
        self.arm.look_at_arm()
        self.body.look_at_arm()

    def _look_at_time(self, late: float) -> None:
        """Give up what cannot go on after so much time [s]."""
        if late < -TIME_BACK:
            self._start_over()
        else:
            self.path.check(late)
            self.body.check(late)
        # While this node is held up, it is not others that are silent.
        elapsed = min(max(late, 0.0), 2.0 * self.options.period)
        self.odom.pass_time(elapsed)
        self.scaling.pass_time(elapsed)
        self.arm_feed.pass_time(elapsed)
        if self.scaling.silent > self.options.scaling_timeout:
            for port in (self.arm, self.body):
                port.give_up(f"no arm/speed_scaling for {self.scaling.silent:.2f} s", brake=True)

    def _start_over(self) -> None:
        """Time went back: what was heard before says nothing about now."""
        self.path.give_up("time went back")
        for port in (self.arm, self.body):
            port.give_up("time went back", brake=False)
        self.watch.restart(self.now())
        self.odom.forget()
        self.arm_feed.forget_place()
        for port in (self.path, self.body, self.tool):
            port.waiting.extend()

    def tick(self) -> None:
        """Publish the next previews and the progress."""
        late, self._ticked = self.now() - self._ticked, self.now()
        self._look_at_time(late)
        self._look()
        for port, what in (
            (self.path, "path"), (self.body, "trajectory"), (self.tool, "tool path"),
        ):  # fmt: skip
            refusal = port.try_waiting()
            if refusal:
                self.warn(f"{what} refused", f"{what} not used: {refusal}")
        if self.together.idle:
            return
        self._progress.publish(Float64(data=self.together.progress()))
        self.together.set_pace(self.body.pace)
        for port in (self.path, self.arm, self.body):
            port.tick()

    # ---- life ---------------------------------------------------------------------------------

    def begin_shutdown(self, reason: str) -> None:
        """Come to rest on the path; nothing else is taken."""
        self.ending = True
        for waiting in (self.path.waiting, self.body, self.tool):
            waiting.drop()
        if not self.together.idle:
            self.together.cancel()
            self.tick()

    @property
    def finished(self) -> bool:
        """Whether nothing is driven, and all clients of actions know it."""
        return self.together.idle and all(action.idle for action in self.actions)

    @property
    def patience(self) -> float:
        """Time of a stop from here [s], and a second."""
        return 1.0 + self.together.remaining() + self.options.core.path.settle

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        now, path, arm, body = self.together.now(), self.path, self.arm, self.body
        values: list[tuple[str, object]] = [
            ("state", path.core.state.value),
            ("path_progress", round(path.core.progress(now), 4)),
            ("remaining_s", round(path.core.remaining(now), 2)),
        ]
        for name, port in (("arm", arm), ("body", body)):
            values += [
                (name, port.core.state.value),
                (f"{name}_progress", round(port.core.progress(now), 4)),
                (f"{name}_last", port.last),
            ]
        values += [("tool_path_last", self.tool.last)]
        values += [("speed_scaling", round(self.scaling.value, 4)), ("last", path.last)]
        latest = max((path, arm, body, self.tool), key=lambda port: port.told)
        if latest.troubled and latest.idle:
            return DiagnosticStatus.WARN, latest.last, values
        return DiagnosticStatus.OK, self.together.state.value, values


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros path_interpolator`."""
    return run(PathInterpolatorNode, args)
