"""Parameters of the robot's laser scanners."""

import math
import re
from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

NO_FAULT, SILENT, FROZEN, COVERED = "none", "silent", "frozen", "covered"  #: Faults of a scanner
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  #: A scanner's name, which can be part of a topic's


@dataclass(frozen=True, kw_only=True)
class ScannerParameters(Validated):
    """Mounting and measurement of a scanner that lies flat; the first beam is its rightmost."""

    name: str = parameter("scanner", "Name, which is also that of its frame.", read_only=True)
    x: float = parameter(0.55, "Position in base_link, forward.", unit="m", low=-10, high=10)
    y: float = parameter(0.0, "Position in base_link, left.", unit="m", low=-10, high=10)
    z: float = parameter(0.2, "Height above the floor.", unit="m", low=0, high=10)
    yaw: float = parameter(0.0, "Direction of its middle.", unit="rad", low=-6.3, high=6.3)
    field_of_view: float = parameter(
        math.pi,
        "Angle from the first to the last beam.",
        unit="rad",
        low=0,
        high=math.tau,
    )
    beams: int = parameter(720, "Number of beams.", low=2, high=100_000, read_only=True)
    range_min: float = parameter(0.05, "Shortest range.", unit="m", low=0, high=100)
    range_max: float = parameter(25.0, "Longest range.", unit="m", low=0.1, high=1000)
    noise: float = parameter(0.0, "Standard deviation of a range.", unit="m", low=0, high=1)
    dropouts: float = parameter(0.0, "Probability that a beam is lost.", low=0, high=1)
    sees_robot: bool = parameter(True, "Whether the robot's own parts are in its way.")
    rate: float = parameter(
        20.0, "Rate, at most the state rate.", unit="Hz", low=1, high=1000, read_only=True
    )
    turned: float = parameter(
        0.0,
        "Angle by which it is turned to the left of how it is said to be mounted.",
        unit="rad",
        low=-3.2,
        high=3.2,
    )
    fault: str = parameter(
        NO_FAULT,
        "Fault: silent sends nothing, frozen repeats the last ranges, covered sees its cover.",
        choices=(NO_FAULT, SILENT, FROZEN, COVERED),
    )

    def __post_init__(self) -> None:
        """Check the name and the ranges.

        Raises:
            ParameterError: The name has other characters than letters, digits and underscores
                or does not begin with a letter, or the longest range is not above the shortest.
        """
        super().__post_init__()
        if not NAME.fullmatch(self.name):
            reason = "must be letters, digits and underscores, and begin with a letter"
            raise self._refusal("name", reason)
        if not self.range_min < self.range_max:
            reason = f"must be above range_min, {self.range_min:g} m"
            raise self._refusal("range_max", reason)
