"""Bring-up of a drive from any state to operational: NMT command, SDO dialogue, NMT start."""

from omniman_ros.can_drives.axis import AxisSettings
from omniman_ros.can_drives.cia402.canopen import NmtCommand, NmtState, nmt
from omniman_ros.can_drives.cia402.objects import TPDO_STATUS
from omniman_ros.can_drives.cia402.sdo import SdoDialogue
from omniman_ros.can_drives.cia402.setup import Abilities, setup
from omniman_ros.can_drives.frame import CanFrame

START_TIMEOUT = 1.0  #: Longest time from NMT start to the first heartbeat and statusword [s]
RETRY_PERIOD = 0.1  #: Period at which unacknowledged frames are repeated [s]


class BringUp:
    """Configures one drive once, and starts it."""

    def __init__(self, settings: AxisSettings) -> None:
        self._node = settings.node
        self._dialogue: SdoDialogue[Abilities] = SdoDialogue(settings.node, setup(settings))
        self._has_begun = False
        self._started_at: float | None = None
        self._sent_at = 0.0
        self.failure = ""

    @property
    def abilities(self) -> Abilities | None:
        """Abilities of the drive, known once its PDOs are mapped."""
        return self._dialogue.result

    def receive(self, data: bytes) -> bool:
        """Process the data of an SDO answer; return whether it answers the pending request."""
        is_answer = self._dialogue.receive(data)
        self.failure = self._dialogue.failure
        return is_answer

    def tick(self, reported: NmtState | None, now: float) -> list[CanFrame]:
        """Return the frames to send now; `reported` is the heartbeat's state since the start."""
        if not self._has_begun:
            self._has_begun = True
            return [nmt(NmtCommand.PRE_OPERATIONAL, self._node)]
        if self._started_at is None:
            frames = self._dialogue.tick(now)
            self.failure = self._dialogue.failure
            if self.failure or not self._dialogue.ended:
                return frames
            self._started_at = now
        elif now - self._started_at > START_TIMEOUT:
            report = "no heartbeat" if reported is None else f"heartbeat reports {reported}"
            self.failure = f"does not become operational after NMT start: {report}"
            if reported is NmtState.OPERATIONAL:
                self.failure = f"sends no statusword ({TPDO_STATUS.name}) after NMT start"
            return []
        elif now - self._sent_at < RETRY_PERIOD:
            return []
        self._sent_at = now
        return [nmt(NmtCommand.START, self._node)]
