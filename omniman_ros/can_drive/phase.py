"""How far all drives together have been brought."""

from enum import Enum


class Phase(Enum):
    """What the drives are to be brought to, or are at."""

    UNCONFIGURED = "unconfigured"
    CONFIGURING = "configuring"
    IDLE = "idle"
    """Configured; no power on the motors, or on the way there."""
    ENABLING = "enabling"
    DRIVING = "driving"
