"""Frames that the host sends to all drives on a CANopen bus: SYNC and its heartbeat."""

import math

from omniman_ros.can_drives.axis import AxisSettings, Network
from omniman_ros.can_drives.cia402.canopen import HEARTBEAT, NMT, SYNC, NmtState, heartbeat, sync
from omniman_ros.can_drives.cia402.setup import HOST_NODE
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.core.errors import InputError


class CanopenNetwork(Network):
    """Sends SYNC and the heartbeat of this host.

    Both frames are sent only from the periodic update of the drives: when the host hangs, its
    heartbeat ends and the drives stop.
    """

    samples_at_sync = True
    command_ids = frozenset({(NMT, False), (SYNC, False), (HEARTBEAT + HOST_NODE, False)})

    def __init__(self, settings: tuple[AxisSettings, ...]) -> None:
        if not settings:
            raise InputError("a CANopen network must have at least one drive")
        # Heartbeats are sent up to half a period early, but never late.
        timeout = min(drive.heartbeat_timeout for drive in settings)
        self._interval = timeout / 4.0 - min(drive.period for drive in settings) / 2.0
        self._last_heartbeat = -math.inf

    def before(self, now: float) -> list[CanFrame]:
        """Return the heartbeat if it is due at `now` [s], else an empty list.

        It is due four times per shortest heartbeat timeout of the drives.
        """
        if now - self._last_heartbeat < self._interval:
            return []
        self._last_heartbeat = now
        return [heartbeat(HOST_NODE, NmtState.OPERATIONAL)]

    def after(self, now: float) -> list[CanFrame]:
        """Return SYNC; the drives measure when they receive it."""
        return [sync()]
