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
from omniman_ros.motion.station.keeper import StationKeeper, StationState
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.station_keeper_parameters import StationKeeperParameters
from omniman_ros.nodes.station_stream import StationStream
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed


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

    # ---- inputs -------------------------------------------------------------------------------

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

    # ---- status -------------------------------------------------------------------------------

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

    # ---- life cycle ---------------------------------------------------------------------------

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
