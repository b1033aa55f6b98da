"""The robot as configuration: geometry, masses, motors and friction of any n >= 3 wheels."""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import REQUIRED, Spec, parameter
from omniman_ros.core.polygon import is_simple, signed_area
from omniman_ros.core.se2 import wrap
from omniman_ros.core.validated import Validated

#: Value of a parameter of all wheels: one for all of them, or one per wheel
Floats = tuple[float, ...]
PER_WHEEL = ("heading", "roller_angle", "radius", "inertia")  #: Arrays that may have one value
PER_WHEEL_FRICTION = ("viscous", "coulomb", "roller")  #: Arrays that may have one value
MOST_WHEELS = 64  #: Largest number of wheels of a usual layout
MOST_CORNERS = 64  #: Largest number of corners of the platform's outline
LEAST_AREA = 0.0025  #: Smallest area of the platform's outline [m^2]
ROUND_OFF = 1e-9  #: How far a corner may be outside of the bounding box [m]


def _distance(name: str) -> Spec:
    return Spec(f"Wheels.{name}", float, unit="m", low=0.01, high=20, doc="A distance.")


@dataclass(frozen=True, kw_only=True)
class Wheels(Validated):
    """Position of each wheel and angle of its rollers (CCTA 2017 Fig. 3); arrays of length n.

    Every array except names, `x` and `y` may be given with one value for all wheels.

    Raises:
        ParameterError: A value is refused, arrays differ in length, there are fewer than three
            wheels, or a name is empty or repeated.
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.names) < 3:
            raise self._refusal("names", "a platform needs at least three wheels")
        for name in self.names:
            if not name or self.names.count(name) > 1:
                raise self._refusal("names", f"'{name}' is empty or repeated")
        for name in ("x", "y", *PER_WHEEL):
            values, n = getattr(self, name), len(self.names)
            if len(values) != n and (len(values) != 1 or name in ("x", "y")):
                raise self._refusal(name, f"has {len(values)} values, {n} wheels")
            object.__setattr__(self, name, values if len(values) == n else values * n)

    @classmethod
    def mecanum(cls, *, wheelbase: float, track: float, radius: float, inertia: float) -> "Wheels":
        """Return four Mecanum wheels at the corners of a rectangle, rollers at +-45 degrees.

        Their order is front left, front right, rear left, rear right. Seen from above, the upper
        rollers make an X.

        Args:
            wheelbase: Distance between the front and the rear axle [m].
            track: Distance between the left and the right wheels [m].
            radius: Wheel radius [m].
            inertia: Inertia of wheel, gear and rotor about the wheel's axle [kg m^2].

        Raises:
            ParameterError: A value is refused.
        """
        x = 0.5 * _distance("wheelbase").check(wheelbase)
        y = 0.5 * _distance("track").check(track)
        angle = 0.25 * math.pi
        return cls(
            names=("front_left", "front_right", "rear_left", "rear_right"),
            x=(x, x, -x, -x),
            y=(y, -y, y, -y),
            roller_angle=(-angle, angle, angle, -angle),
            radius=(radius,),
            inertia=(inertia,),
        )

    @classmethod
    def omni(cls, *, count: int, distance: float, radius: float, inertia: float) -> "Wheels":
        """Return Omni wheels on a circle, the first one ahead, the others counter-clockwise.

        Forward, a wheel rolls counter-clockwise around the circle.

        Args:
            count: Number n >= 3 of wheels, which are named wheel_1 to wheel_n.
            distance: Distance of the contacts from the centre [m].
            radius: Wheel radius [m].
            inertia: Inertia of wheel, gear and rotor about the wheel's axle [kg m^2].

        Raises:
            ParameterError: A value is refused.
        """
        distance = _distance("distance").check(distance)
        count = Spec("Wheels.count", int, low=3, high=MOST_WHEELS, doc="Number.").check(count)
        angles = [2.0 * math.pi * k / count for k in range(count)]
        return cls(
            names=tuple(f"wheel_{k + 1}" for k in range(count)),
            x=tuple(distance * math.cos(angle) for angle in angles),
            y=tuple(distance * math.sin(angle) for angle in angles),
            heading=tuple(wrap(angle + 0.5 * math.pi) for angle in angles),
            roller_angle=(0.0,),
            radius=(radius,),
            inertia=(inertia,),
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
class Body(Validated):
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
        super().__post_init__()
        x, y = self.outline_x, self.outline_y
        if len(x) != len(y):
            raise self._refusal("outline_y", f"has {len(y)} values, outline_x {len(x)}")
        if not x:
            return
        if not 3 <= len(x) <= MOST_CORNERS:
            raise self._refusal("outline_x", f"needs 3 to {MOST_CORNERS} corners")
        for name, values, size in (("x", x, self.length), ("y", y, self.width)):
            if max(map(abs, values)) > 0.5 * size + ROUND_OFF:
                reason = f"leaves the bounding box, which ends at {0.5 * size:g} m"
                raise self._refusal(f"outline_{name}", reason)
        corners = np.column_stack((x, y))
        if not is_simple(corners):
            raise self._refusal("outline_x", "the sides of the outline cross or touch")
        if abs(signed_area(corners)) < LEAST_AREA:
            reason = f"the outline is smaller than {LEAST_AREA:g} m^2"
            raise self._refusal("outline_x", reason)

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
class Arm(Validated):
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
        super().__post_init__()
        if len(self.tool_centre) != 3:
            reason = "must have three coordinates"
            raise self._refusal("tool_centre", reason)


@dataclass(frozen=True, kw_only=True)
class Motor(Validated):
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
class Friction(Validated):
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
class Platform(Validated):
    """Configuration of a whole platform; friction with one value holds for all n wheels.

    Raises:
        ParameterError: The friction's arrays have neither one value nor one for each wheel.
    """

    wheels: Wheels
    body: Body
    arm: Arm
    motor: Motor
    friction: Friction

    def __post_init__(self) -> None:
        super().__post_init__()
        n = self.wheel_count
        for name in PER_WHEEL_FRICTION:
            values = getattr(self.friction, name)
            if len(values) not in (1, n):
                raise self._refusal(f"friction.{name}", f"has {len(values)} values, {n} wheels")
            if len(values) != n:
                friction = replace(self.friction, **{name: values * n})
                object.__setattr__(self, "friction", friction)

    @property
    def wheel_count(self) -> int:
        """Number of wheels n."""
        return len(self.wheels.names)
