"""Stream of references of the node `station_keeper`, from a station's acceptance to rest."""

from omniman_ros.core.pending_start import PendingStart
from omniman_ros.core.planar import Triple
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.motion.station.keeper import StationKeeper, StationState
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.station_keeper_parameters import StationKeeperParameters
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed
from omniman_ros.nodes.trajectory_interfaces.previews import platform_previews


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
        self.odom = OdomFeed(node, "odom", p.odom_frame, lambda pose, at: None)
        self._pending = PendingStart(node.now, self.monitor)
        self._previews = platform_previews(node, "station/reference", p.odom_frame, p.horizon)
        self._ticked_at = node.now()
        self._logged = (core.state, core.reason)
        StreamMonitorInterface(node, self.monitor, self._abort_if_lost)

    # ---- requests -----------------------------------------------------------------------------

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

    # ---- start and end ------------------------------------------------------------------------

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

    # ---- cycle --------------------------------------------------------------------------------

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
