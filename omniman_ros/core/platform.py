"""The robot as configuration: geometry, masses, motors and friction of any n >= 3 wheels."""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import REQUIRED, flatten, parameter
from omniman_ros.core.polygon import is_simple, signed_area

#: Value of a parameter of all wheels: one for all of them, or one per wheel
Floats = tuple[float, ...]
#: Parameter group whose arrays have one value per wheel
Group = TypeVar("Group", "Wheels", "Friction")
MOST_CORNERS = 64  #: Largest number of corners of the platform's outline
LEAST_AREA = 0.0025  #: Smallest area of the platform's outline [m^2]
ROUND_OFF = 1e-9  #: How far a corner may be outside of the bounding box [m]


@dataclass(frozen=True, kw_only=True)
class Wheels:
    """Position of each wheel and angle of its rollers (CCTA 2017 Fig. 3); arrays of length n.

    Every array except names, `x` and `y` may have one value for all wheels.
    """

    names: tuple[str, ...] = parameter(
        REQUIRED, "Names of the wheels, in the order of all arrays.", read_only=True
    )
    x: Floats = parameter(
        REQUIRED,
        "Position of each wheel's contact in base_link, forward.",
        unit="m",
        low=-10,
        high=10,
        read_only=True,
    )
    y: Floats = parameter(
        REQUIRED,
        "Position of each wheel's contact in base_link, left.",
        unit="m",
        low=-10,
        high=10,
        read_only=True,
    )
    heading: Floats = parameter(
        (0.0,),
        "Rolling direction of each wheel in base_link (delta).",
        unit="rad",
        low=-6.3,
        high=6.3,
        read_only=True,
    )
    roller_angle: Floats = parameter(
        REQUIRED,
        "Angle from the wheel's to the roller's frame (gamma), 0 for Omni wheels.",
        unit="rad",
        low=-1.5708,
        high=1.5708,
        read_only=True,
    )
    radius: Floats = parameter(
        REQUIRED, "Wheel radius.", unit="m", low=0.005, high=2, read_only=True
    )
    inertia: Floats = parameter(
        REQUIRED,
        "Inertia of wheel, gear and rotor about the wheel's axle.",
        unit="kg m^2",
        low=1e-7,
        high=100,
        read_only=True,
    )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the wheels' joints in the URDF and on `joint_states`, in the same order.

        They are the wheels' names with `_wheel_joint`; a name that ends in `_joint` stays.
        """
        return tuple(
            name if name.endswith("_joint") else f"{name}_wheel_joint" for name in self.names
        )


@dataclass(frozen=True, kw_only=True)
class Body:
    """The platform without the arm.

    Raises:
        ParameterError: The outline is not a simple polygon within the bounding box.
    """

    mass: float = parameter(REQUIRED, "Mass, wheels included.", unit="kg", low=0.1, high=1e5)
    inertia: float = parameter(
        REQUIRED,
        "Inertia about the vertical through its centre of mass, the wheels as points.",
        unit="kg m^2",
        low=1e-4,
        high=1e6,
    )
    com_x: float = parameter(0.0, "Centre of mass, forward.", unit="m", low=-5, high=5)
    com_y: float = parameter(0.0, "Centre of mass, left.", unit="m", low=-5, high=5)
    com_z: float = parameter(
        0.0,
        "Height of the centre of mass above the floor; 0 means unknown: no load transfer by it.",
        unit="m",
        low=0,
        high=5,
    )
    length: float = parameter(
        REQUIRED,
        "Length of the bounding box, whose centre is base_link.",
        unit="m",
        low=0.05,
        high=20,
        read_only=True,
    )
    width: float = parameter(
        REQUIRED, "Width of the bounding box.", unit="m", low=0.05, high=20, read_only=True
    )
    outline_x: Floats = parameter(
        (),
        "Corners of the platform's outline from above in base_link, forward: a polygon, convex or "
        "not, in order around it. None: the bounding box.",
        unit="m",
        low=-10,
        high=10,
        read_only=True,
    )
    outline_y: Floats = parameter(
        (),
        "Corners of the platform's outline from above in base_link, left.",
        unit="m",
        low=-10,
        high=10,
        read_only=True,
    )

    def __post_init__(self) -> None:
        x, y = self.outline_x, self.outline_y
        if len(x) != len(y):
            raise ParameterError("body.outline_y", y, f"has {len(y)} values, outline_x {len(x)}")
        if not x:
            return
        if not 3 <= len(x) <= MOST_CORNERS:
            raise ParameterError("body.outline_x", x, f"needs 3 to {MOST_CORNERS} corners")
        for name, values, size in (("x", x, self.length), ("y", y, self.width)):
            if max(map(abs, values)) > 0.5 * size + ROUND_OFF:
                reason = f"leaves the bounding box, which ends at {0.5 * size:g} m"
                raise ParameterError(f"body.outline_{name}", values, reason)
        corners = np.column_stack((x, y))
        if not is_simple(corners):
            raise ParameterError("body.outline_x", x, "the sides of the outline cross or touch")
        if abs(signed_area(corners)) < LEAST_AREA:
            reason = f"the outline is smaller than {LEAST_AREA:g} m^2"
            raise ParameterError("body.outline_x", x, reason)

    @property
    def outline(self) -> Array | None:
        """Corners (K, 2) of the outline in base_link, counter-clockwise [m]; None: the box."""
        if not self.outline_x:
            return None
        corners: Array = np.column_stack((self.outline_x, self.outline_y))
        return corners if signed_area(corners) > 0.0 else corners[::-1]

    def outline_at(self, pose: Array) -> Array:
        """Return the corners (K, 2) of outline or bounding box at a pose (3,), in its frame [m].

        They are in order, counter-clockwise.
        """
        corners = self.outline
        if corners is None:
            half = 0.5 * np.array([self.length, self.width])
            corners = half * [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]
        placed: Array = corners @ se2.rotation(float(pose[2]))[:2, :2] + pose[:2]
        return placed


@dataclass(frozen=True, kw_only=True)
class Arm:
    """The arm as a body at rest on the platform; mass 0 means that there is none.

    Inertia and centre of mass are those of one posture, for as long as no other is known.

    Raises:
        ParameterError: The centre of the tool has not three coordinates.
    """

    mass: float = parameter(0.0, "Mass, tool and load included.", unit="kg", low=0, high=1e4)
    inertia: float = parameter(
        0.0,
        "Inertia about the vertical through its centre of mass.",
        unit="kg m^2",
        low=0,
        high=1e5,
    )
    com_x: float = parameter(0.0, "Centre of mass, forward.", unit="m", low=-5, high=5)
    com_y: float = parameter(0.0, "Centre of mass, left.", unit="m", low=-5, high=5)
    com_z: float = parameter(
        0.0,
        "Height of the centre of mass above the floor; 0 means unknown: no load transfer by it.",
        unit="m",
        low=0,
        high=10,
    )
    tool_centre: Floats = parameter(
        (0.0, 0.0, 0.05),
        "Centre of mass of tool and load in tool0: x, y, z. Their mass is what mass has beyond "
        "the arm's links.",
        unit="m",
        low=-2,
        high=2,
    )

    def __post_init__(self) -> None:
        if len(self.tool_centre) != 3:
            reason = "must have three coordinates"
            raise ParameterError("arm.tool_centre", self.tool_centre, reason)


@dataclass(frozen=True, kw_only=True)
class Motor:
    """DC motors with gears; electrical values are at the motor (CCTA 2017 (22), MPC 2021 (21))."""

    resistance: float = parameter(
        REQUIRED, "Armature resistance R.", unit="ohm", low=1e-4, high=1e4
    )
    inductance: float = parameter(REQUIRED, "Armature inductance L.", unit="H", low=0, high=1)
    torque_constant: float = parameter(
        REQUIRED, "Torque and back-EMF constant K.", unit="V s/rad", low=1e-5, high=100
    )
    gear_ratio: float = parameter(
        REQUIRED, "Motor revolutions per wheel revolution, N.", low=0.01, high=1e4, read_only=True
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
        REQUIRED, "Largest wheel speed that is commanded.", unit="rad/s", low=0.01, high=1000
    )
    encoder_counts: int = parameter(
        REQUIRED,
        "Encoder counts per wheel revolution.",
        low=1,
        high=1_000_000_000,
        read_only=True,
    )


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
        (0.0,),
        "Drag of a rolling roller along its free direction, over the wheel's load; it makes "
        "sideways motion need more torque than forward motion.",
        low=0,
        high=1,
    )
    mu: float = parameter(0.6, "Coefficient of friction, roller on floor.", low=0.01, high=5)


@dataclass(frozen=True)
class Platform:
    """Configuration of a whole platform; arrays with one value are broadcast to the n wheels.

    Raises:
        ParameterError: Arrays differ in length, there are fewer than three wheels, or a name is
            empty or repeated.
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
                raise ParameterError("wheels.names", names, f"'{name}' is empty or repeated")
        for group in ("wheels", "friction"):
            object.__setattr__(self, group, self._broadcast(group, getattr(self, group)))

    def _broadcast(self, prefix: str, group: Group) -> Group:
        n = len(self.wheels.names)
        arrays: dict[str, Any] = {}
        for key, value in flatten(group).items():
            if not isinstance(value, tuple):
                continue
            if len(value) not in (1, n) or (len(value) == 1 and key in ("x", "y")):
                reason = f"{len(value)} values, {n} wheels"
                raise ParameterError(f"{prefix}.{key}", value, f"has {reason}")
            arrays[key] = value if len(value) == n else value * n
        return replace(group, **arrays)

    @property
    def wheel_count(self) -> int:
        """Number of wheels n."""
        return len(self.wheels.names)
