"""From whatever a drive does to an operational one: NMT, the dialogue of SDOs, NMT start."""

from omniman_ros.can_drive.axis import AxisSettings
from omniman_ros.can_drive.canopen import NmtCommand, NmtState, nmt
from omniman_ros.can_drive.cia402_objects import TPDO_STATUS
from omniman_ros.can_drive.cia402_setup import Abilities, setup
from omniman_ros.can_drive.frame import Frame
from omniman_ros.can_drive.sdo import SdoDialogue

START_PATIENCE = 1.0
"""How long a drive may take from NMT start to its first heartbeat and statusword, s."""
RETRY = 0.1
"""Period of what is sent again because nobody acknowledges it, s."""


class BringUp:
    """One configuration of one drive.

    Args:
        settings: Of the drive.

    Attributes:
        failure: Why it came to nothing, or empty.
    """

    def __init__(self, settings: AxisSettings) -> None:
        self._node = settings.node
        self._dialogue: SdoDialogue[Abilities] = SdoDialogue(settings.node, setup(settings))
        self._begun = False
        self._started: float | None = None
        self._sent = 0.0
        self.failure = ""

    @property
    def abilities(self) -> Abilities | None:
        """What the drive can, from when its PDOs are mapped."""
        return self._dialogue.result

    def receive(self, data: bytes) -> bool:
        """Take an SDO answer; return whether it is one to the request in flight."""
        taken = self._dialogue.receive(data)
        self.failure = self._dialogue.failure
        return taken

    def tick(self, heard: NmtState | None, now: float) -> list[Frame]:
        """Return what is to be sent now.

        Args:
            heard: State that the drive's heartbeat has said since its start.
            now: Time, s.
        """
        if not self._begun:
            self._begun = True
            return [nmt(NmtCommand.PRE_OPERATIONAL, self._node)]
        if self._started is None:
            frames = self._dialogue.tick(now)
            self.failure = self._dialogue.failure
            if self.failure or not self._dialogue.ended:
                return frames
            self._started = now
        elif now - self._started > START_PATIENCE:
            said = "no heartbeat" if heard is None else f"heartbeat says {heard}"
            self.failure = f"does not become operational after NMT start: {said}"
            if heard is NmtState.OPERATIONAL:
                self.failure = f"sends no statusword ({TPDO_STATUS.name}) after NMT start"
            return []
        elif now - self._sent < RETRY:
            return []
        self._sent = now
        return [nmt(NmtCommand.START, self._node)]
