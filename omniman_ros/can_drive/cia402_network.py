"""What a CANopen bus with CiA 402 drives carries besides their own frames."""

import math
from collections.abc import Collection

from omniman_ros.can_drive.axis import AxisSettings
from omniman_ros.can_drive.canopen import HEARTBEAT, NMT, SYNC, NmtState, heartbeat, sync
from omniman_ros.can_drive.cia402_setup import MASTER
from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.errors import InputError


class CanopenNetwork:
    """Heartbeat of this host and SYNC; see `axis.Network`.

    Both come from the tick alone: when the host hangs, the heartbeat ends with it and the drives
    stop.

    Args:
        settings: Of all drives on the bus.

    Raises:
        InputError: There are none.
    """

    def __init__(self, settings: tuple[AxisSettings, ...]) -> None:
        if not settings:
            raise InputError("a CANopen network without drives")
        self.command_ids: Collection[tuple[int, bool]] = frozenset(
            {(NMT, False), (SYNC, False), (HEARTBEAT + MASTER, False)}
        )
        self.samples = True
        # Half a period early rather than as much late.
        timeout = min(one.heartbeat_timeout for one in settings)
        self._interval = timeout / 4.0 - min(one.period for one in settings) / 2.0
        self._last = -math.inf

    def before(self, now: float) -> list[Frame]:
        """Return the heartbeat, four times in the drives' time-out or, if that is less, always."""
        if now - self._last < self._interval:
            return []
        self._last = now
        return [heartbeat(MASTER, NmtState.OPERATIONAL)]

    def after(self, now: float) -> list[Frame]:
        """Return SYNC."""
        return [sync()]
