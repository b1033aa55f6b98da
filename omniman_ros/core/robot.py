"""The robot as configuration: geometry, masses, motors and friction of any n >= 3 wheels."""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import REQUIRED, flatten, parameter

Floats = tuple[float, ...]
Group = TypeVar("Group", "Wheels", "Friction")


@dataclass(frozen=True, kw_only=True)
class Wheels:
    """Where each wheel stands and how its rollers lie (CCTA 2017 Fig. 3); arrays of length n.

    `radius` and `inertia` may have one value for all wheels.
    """

    names: tuple[str, ...] = parameter(
        REQUIRED, "Names of the wheels, in the order of all arrays.", read_only=True
    )
    x: Floats = parameter(
        REQUIRED, "Position of each wheel's contact in base_link, forward.",
        unit="m", low=-10, high=10, read_only=True,
    )  # fmt: skip
    y: Floats = parameter(
        REQUIRED, "Position of each wheel's contact in base_link, left.",
        unit="m", low=-10, high=10, read_only=True,
    )  # fmt: skip
    heading: Floats = parameter(
        (0.0,), "Rolling direction of each wheel in base_link (delta).",
        unit="rad", low=-6.3, high=6.3, read_only=True,
    )  # fmt: skip
    roller_angle: Floats = parameter(
        REQUIRED, "Angle from the wheel's to the roller's frame (gamma), 0 for Omni wheels.",
        unit="rad", low=-1.5708, high=1.5708, read_only=True,
    )  # fmt: skip
    radius: Floats = parameter(
        REQUIRED, "Wheel radius.", unit="m", low=0.005, high=2, read_only=True
    )
    inertia: Floats = parameter(
        REQUIRED, "Inertia of wheel, gear and rotor about the wheel's axle.",
        unit="kg m^2", low=1e-7, high=100, read_only=True,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Body:
    """The platform without the arm."""

    mass: float = parameter(REQUIRED, "Mass, wheels included.", unit="kg", low=0.1, high=1e5)
    inertia: float = parameter(
        REQUIRED, "Inertia about the vertical through its centre of mass, the wheels as points.",
        unit="kg m^2", low=1e-4, high=1e6,
    )  # fmt: skip
    com_x: float = parameter(0.0, "Centre of mass, forward.", unit="m", low=-5, high=5)
    com_y: float = parameter(0.0, "Centre of mass, left.", unit="m", low=-5, high=5)
    length: float = parameter(
        REQUIRED, "Length of the bounding box.", unit="m", low=0.05, high=20, read_only=True
    )
    width: float = parameter(
        REQUIRED, "Width of the bounding box.", unit="m", low=0.05, high=20, read_only=True
    )


@dataclass(frozen=True, kw_only=True)
class Arm:
    """The arm, seen by the platform as a body at rest on it; mass 0 for none."""

    mass: float = parameter(0.0, "Mass, tool and load included.", unit="kg", low=0, high=1e4)
    inertia: float = parameter(
        0.0, "Inertia about the vertical through its centre of mass.",
        unit="kg m^2", low=0, high=1e5,
    )  # fmt: skip
    com_x: float = parameter(0.0, "Centre of mass, forward.", unit="m", low=-5, high=5)
    com_y: float = parameter(0.0, "Centre of mass, left.", unit="m", low=-5, high=5)


@dataclass(frozen=True, kw_only=True)
class Motor:
    """DC motors with gear; electrical values at the motor (CCTA 2017 (22), MPC 2021 (21))."""

    resistance: float = parameter(
        REQUIRED, "Armature resistance R.", unit="ohm", low=1e-4, high=1e4
    )
    inductance: float = parameter(REQUIRED, "Armature inductance L.", unit="H", low=0, high=1)
    torque_constant: float = parameter(
        REQUIRED, "Torque and back-EMF constant K.", unit="V s/rad", low=1e-5, high=100
    )
    gear_ratio: float = parameter(
        REQUIRED, "Turns of the motor per turn of the wheel N.", low=0.01, high=1e4, read_only=True
    )
    gear_efficiency: float = parameter(
        1.0, "Efficiency eta of the gear when the motor drives.", low=0.05, high=1
    )
    max_voltage: float = parameter(
        REQUIRED, "Largest voltage the amplifier gives.", unit="V", low=0.1, high=2000
    )
    max_current: float = parameter(
        REQUIRED, "Largest armature current.", unit="A", low=0.01, high=5000
    )
    max_speed: float = parameter(
        REQUIRED, "Largest wheel speed that is asked for.", unit="rad/s", low=0.01, high=1000
    )
    encoder_counts: int = parameter(
        REQUIRED, "Encoder counts in one turn of the wheel.", low=1, high=1_000_000_000,
        read_only=True,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Friction:
    """Friction at the wheel (CCTA 2017 (23), MPC 2021 (24)); one value or one per wheel."""

    viscous: Floats = parameter(
        (0.0,), "Viscous friction a at the wheel's axle.", unit="N m s/rad", low=0, high=1e3
    )
    coulomb: Floats = parameter(
        (0.0,), "Coulomb friction b at the wheel's axle.", unit="N m", low=0, high=1e4
    )
    roller: Floats = parameter(
        (0.0,), "Drag of a turning roller along its free direction, over the wheel's load: "
        "what makes sideways harder than forwards.", low=0, high=1,
    )  # fmt: skip
    mu: float = parameter(0.6, "Coefficient of friction, roller on floor.", low=0.01, high=5)


@dataclass(frozen=True)
class Robot:
    """A whole platform; per-wheel arrays are broadcast to n.

    Raises:
        ParameterError: Arrays of different lengths, fewer than three wheels, a name twice.
    """

    wheels: Wheels
    body: Body
    arm: Arm
    motor: Motor
    friction: Friction

    def __post_init__(self) -> None:
        names = self.wheels.names
        if len(names) < 3:
            raise ParameterError("wheels.names", names, "a platform needs at least three wheels")
        for name in names:
            if not name or names.count(name) > 1:
                raise ParameterError("wheels.names", names, f"'{name}' is empty or there twice")
        for group in ("wheels", "friction"):
            object.__setattr__(self, group, self._broadcast(group, getattr(self, group)))

    def _broadcast(self, prefix: str, group: Group) -> Group:
        n = len(self.wheels.names)
        arrays: dict[str, Any] = {}
        for key, value in flatten(group).items():
            if not isinstance(value, tuple):
                continue
            if len(value) not in (1, n) or (len(value) == 1 and key in ("x", "y")):
                raise ParameterError(f"{prefix}.{key}", value, f"{len(value)} values, {n} wheels")
            arrays[key] = value if len(value) == n else value * n
        return replace(group, **arrays)

    @property
    def wheel_count(self) -> int:
        """Number of wheels n."""
        return len(self.wheels.names)
