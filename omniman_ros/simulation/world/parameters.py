"""Parameters of the physics world; those of motors, firmware and faults are the plant's."""

from dataclasses import dataclass

from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

Floats = tuple[float, ...]  #: Angle of each joint [rad]
IDEAL = "ideal"  #: Wheels with one contact that slips along the roller's axis and rolls across
ROLLERS = "rollers"  #: Kind of wheel: passive rollers around its rim, each a body of its own


@dataclass(frozen=True)
class WorldParameters(Validated):
    """Wheels, and what happens in contacts."""

    wheels: str = parameter(
        ROLLERS,
        "Wheels with passive rollers, or ideal ones with a single contact.",
        choices=(IDEAL, ROLLERS),
        read_only=True,
    )
    rollers: int = parameter(12, "Number of rollers of a wheel.", low=6, high=36, read_only=True)
    roller_radius: float = parameter(
        0.16,
        "Radius of a roller at its middle, over the wheel's.",
        low=0.03,
        high=0.4,
        read_only=True,
    )
    posture: Floats = parameter(
        (0.0, -1.57, 1.57, -1.57, -1.57, 0.0),
        "Joint angles of the arm at the start.",
        unit="rad",
        low=-6.3,
        high=6.3,
        read_only=True,
    )
    tyre_stiffness: float = parameter(
        1e6,
        "Stiffness of each wheel's contact: the softer, the more evenly the wheels are loaded.",
        unit="N/m",
        low=1e3,
        high=1e7,
        read_only=True,
    )
    contact_time: float = parameter(
        0.05,
        "Time constant of the filter of contact forces, whose peaks follow the stiffness that "
        "the simulation has and not the one of the bodies.",
        unit="s",
        low=0.001,
        high=10,
        read_only=True,
    )
    person_force: float = parameter(
        150.0,
        "Largest force with which a person pushes on.",
        unit="N",
        low=0,
        high=10000,
        read_only=True,
    )

    def __post_init__(self) -> None:
        """Check the posture.

        Raises:
            ParameterError: It does not have one angle per joint.
        """
        super().__post_init__()
        if len(self.posture) != JOINTS:
            reason = f"must be {JOINTS} angles"
            raise self._refusal("posture", reason)
