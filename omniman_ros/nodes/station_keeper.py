"""Node `station_keeper`: keeps a station relative to another robot that moves."""

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import Trigger

from omniman_ros.conversions.poses import goal_pose_from_message
from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.pending_start import PendingStart
from omniman_ros.core.planar import Triple
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.motion.station.keeper import StationKeeper, StationState
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.robot_streams import OdomFeed, platform_previews
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.station_keeper_parameters import StationKeeperParameters
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface


class StationStream:
    """Starts, supervises and publishes the motion of a station keeper."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[StationKeeperParameters],
        core: StationKeeper,
    ) -> None:
        p = settings.value
        self._node, self._settings, self._core = node, settings, core
        self.monitor = StreamMonitor(p.restart, "station")
        self.odom = OdomFeed(node, "odom", p.odom_frame)
        self._pending = PendingStart(node.now, self.monitor)
        self._previews = platform_previews(node, "station/reference", p.odom_frame, p.horizon)
        self._ticked_at = node.now()
        self._logged = (core.state, core.reason)
        StreamMonitorInterface(node, self.monitor, self._abort_if_lost)

    def submit(self, offset: Triple) -> str:
        """Approach a station [m, m, rad] as soon as possible; return why it is refused, or ""."""
        self._pending.put(lambda: self._start(offset))
        return self._start_pending()

    def release(self) -> bool:
        """Bring the robot to rest and forget the station; return whether there was one."""
        was_pending = self._pending.discard()
        was_active = self._core.state is not StationState.IDLE
        self._core.release()
        return was_pending or was_active

    def _start_pending(self) -> str:
        return self._pending.attempt(self.monitor.blocking_reason, self._blocking_reason).refusal

    def _blocking_reason(self) -> str:
        """Return why no station can be approached yet, or an empty string."""
        if self._core.state is not StationState.IDLE:
            return ""
        why = self.odom.blocking_reason(self._settings.value.odom_timeout)
        waits = self.monitor.waiting_time(self._node.now()) > 0.0
        return why or ("control was lost a moment ago" if waits else "")

    def _start(self, offset: Triple) -> None:
        assert self.odom.pose is not None
        now = self._node.now()
        if self._core.state is StationState.IDLE:
            self.odom.silence = 0.0
        self._core.keep(offset, self.odom.pose, now)
        self.monitor.begin(now)
        self._send(now)

    def _abort(self, reason: str) -> None:
        """Forget the station at once, as the robot does not follow any more."""
        if self._core.state is not StationState.IDLE:
            self._core.abort(reason)
            self.monitor.end(lost=True)

    def _abort_if_lost(self) -> None:
        reason = self.monitor.loss_reason(self._node.now())
        if reason:
            self._abort(reason)

    def tick(self) -> None:
        """Supervise the motion, start a station that waits, and publish the next preview."""
        now = self._node.now()
        elapsed, self._ticked_at = now - self._ticked_at, now
        if elapsed < -TIME_JUMP:
            self._start_over(now)
        # While this node is held up, odom is not silent.
        self.odom.pass_time(min(max(elapsed, 0.0), 2.0 * self._settings.value.period))
        self._abort_if_lost()
        refusal = self._start_pending()
        if refusal:
            self._node.warn("station refused", f"station not used: {refusal}")
        if self._core.state is not StationState.IDLE:
            self._go_on(now)
        self._log_changes()

    def _go_on(self, now: float) -> None:
        """Supervise the motion under way, and publish the next preview."""
        core, odom = self._core, self.odom
        assert odom.pose is not None
        if now > core.end:
            self._abort("no preview was sent in time")
            return
        if odom.silence > self._settings.value.odom_timeout:
            core.give_up(f"no odom for {odom.silence:.2f} s")
        core.update(odom.pose, odom.time, now)
        if core.state is StationState.IDLE:
            self.monitor.end(lost=False)
        self._send(now)

    def _send(self, now: float) -> None:
        window = self._core.window(now, self._settings.value.horizon)
        if window is not None:
            self._previews.send(window)
            self.monitor.sent(now)

    def _start_over(self, now: float) -> None:
        """Forget everything that was received, because time went back."""
        self._abort("time went back")
        self.monitor.restart(now)
        self.odom.forget()
        self._core.forget_leader()
        self._pending.restart_timeout()

    def _log_changes(self) -> None:
        state, reason = self._core.state, self._core.reason
        if (state, reason) != self._logged:
            self._logged = (state, reason)
            self._node.get_logger().info(f"{state.value}: {reason}" if reason else state.value)


class StationKeeperNode(OmnimanNode):
    """Connects a station keeper to its topics."""

    def __init__(self, **options: Any) -> None:
        super().__init__("station_keeper", **options)
        self.settings = ParameterSet(self, StationKeeperParameters)
        p = self.settings.value
        self.core = StationKeeper(p.core)
        self.settings.on_change(self._configure)
        self.stream = StationStream(self, self.settings, self.core)
        self._leader = OdomFeed(self, p.leader_topic, p.leader_frame, self._on_leader)
        self._is_ending = False
        self._limit_scales = LimitScales()
        for kind, topic, handler, qos in (
            (PoseStamped, "station", self._on_station, 10),
            (DiagnosticStatus, "wheel_health", self._on_health, LATCHED),
        ):
            self.create_subscription(kind, topic, self.guarded(topic, handler), qos)
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self.every(p.period, self.stream.tick)

    def _configure(self, new: StationKeeperParameters) -> None:
        self.core.configure(new.core)
        self.stream.monitor.silence = new.restart

    def _on_leader(self, pose: Array, at: float) -> None:
        x, y, theta = pose.tolist()
        self.core.update_leader(at, (x, y, theta), se2.to_robot(theta, self._leader.velocity))

    def _on_health(self, message: DiagnosticStatus) -> None:
        scales, before = reported_limit_scales(message), self._limit_scales
        self._limit_scales = scales
        if scales.wheels > before.wheels:  # the controller was reset, and expects a silence
            self.stream.monitor.restart(self.now())
        if scales.total != self.core.limit_scale:
            self.core.scale_limits(scales.total)

    def _on_station(self, message: PoseStamped) -> str:
        if self._is_ending:
            raise InputError("the node is shutting down")
        self.demand_not_ahead(message.header.stamp)
        pose = goal_pose_from_message(message, [self.settings.value.leader_base_frame])
        x, y, theta = pose.tolist()
        return self.stream.submit((x, y, theta))

    def _on_cancel(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.stream.release()
        response.message = self.core.state.value
        return response

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        core = self.core
        x, y, angle = core.error.tolist()
        values: list[tuple[str, object]] = [
            ("state", core.state.value),
            ("distance_m", round(math.hypot(x, y), 4)),
            ("heading_error_rad", round(angle, 4)),
            ("leader_silence_s", round(core.leader_silence(self.now()), 3)),
        ]
        if core.reason:
            return DiagnosticStatus.WARN, f"the station was given up: {core.reason}", values
        is_waiting = core.state is StationState.WAITING
        level = DiagnosticStatus.WARN if is_waiting else DiagnosticStatus.OK
        return level, core.state.value, values

    def begin_shutdown(self, reason: str) -> None:
        """Bring the robot to rest, and accept no other station."""
        self._is_ending = True
        self.stream.release()

    @property
    def finished(self) -> bool:
        """Whether no motion is under way."""
        return self.core.state is StationState.IDLE

    @property
    def stop_timeout(self) -> float:
        """How long the robot may take to come to rest [s], with a margin of 1 s."""
        return 1.0 + self.core.stop_time


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros station_keeper`."""
    return run(StationKeeperNode, args)
