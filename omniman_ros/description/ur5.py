"""Links of the UR5, in the frames of its public description.

Joint angles rotate each link about z of its frame. Lengths are those of the DH table in
`core.arm_model`; the shapes are our own.

Sources: Universal Robots, "DH parameters for calculations of kinematics and dynamics" and "Max.
joint torques", as they stand in ur_description, config/ur5 (physical_parameters.yaml,
joint_limits.yaml): masses, centres of mass, radii, offsets along the axes, torques; the data sheet
of the UR5: the mass of the whole arm.
"""

import math
from dataclasses import dataclass

from omniman_ros.core.arm_model import UR5, DhTable
from omniman_ros.description.inertia import Inertia, Vector, cylinder

QUARTER_TURN = 0.5 * math.pi  #: Angle of 90 degrees [rad]
EFFORTS = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)  #: Largest torque of each joint [N m]
#: Assumed moment of inertia of each joint's rotor and gear, at the joint [kg m^2]
ROTOR_INERTIAS = (0.5, 0.5, 0.5, 0.1, 0.1, 0.1)
#: Offset of the upper arm from the first axis, along the axis of shoulder_lift [m]
SHOULDER_OFFSET = 0.13585
ELBOW_OFFSET = 0.0165  #: Offset of the forearm from the first axis, along the axis of elbow [m]
ARM_MASS = 18.4  #: Mass of the whole arm without a tool [kg] (data sheet)
#: Masses of the moving links, from the base on [kg]
MOVING_MASSES = (3.7, 8.393, 2.33, 1.219, 1.219, 0.1879)
TOOL = "tool"  #: Name of what is mounted at the flange
#: Assumed centre of mass of tool and load in the frame of the flange, `tool0` [m]
TOOL_CENTRE: Vector = (0.0, 0.0, 0.05)
TOOL_GYRATION = 0.04  #: Assumed radius of gyration of tool and load about each axis [m]
FLANGE = 0.03  #: Thickness of the last link [m]
BASE_HEIGHT = 0.05  #: Height of the part that is fixed to the platform [m]


@dataclass(frozen=True)
class Tube:
    """A cylinder in a link's frame.

    Attributes:
        start, end: Centres of the end faces [m].
    """

    start: Vector
    end: Vector
    radius: float  #: Radius [m]

    @property
    def length(self) -> float:
        """Distance between the ends [m]."""
        return math.dist(self.start, self.end)

    @property
    def centre(self) -> Vector:
        """Centre of the cylinder [m]."""
        x, y, z = (0.5 * (a + b) for a, b in zip(self.start, self.end, strict=True))
        return x, y, z

    @property
    def rpy(self) -> Vector:
        """Rotation of the link's frame after which z points from start to end [rad]."""
        x, y, z = (b - a for a, b in zip(self.start, self.end, strict=True))
        return 0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x) if x or y else 0.0


@dataclass(frozen=True)
class Link:
    """A link of the arm."""

    name: str  #: Public name
    #: Position of the frame in that of the previous link, with the joint at zero [m]
    place: Vector
    #: Rotation of the frame in that of the previous link, with the joint at zero [rad]
    rpy: Vector
    mass: float  #: Mass [kg]
    centre: Vector  #: Centre of mass [m]
    tubes: tuple[Tube, ...]  #: Shape; the first tube also determines the moments of inertia

    @property
    def inertia(self) -> Inertia:
        """Inertia of a cylinder like the first tube, about the centre of mass."""
        first = self.tubes[0]
        return cylinder(self.mass, first.radius, first.length, self.centre, first.rpy)


BASE = Link(
    "arm_base_link_inertia",
    (0.0, 0.0, 0.0),
    (0.0, 0.0, math.pi),
    ARM_MASS - sum(MOVING_MASSES),
    (0.0, 0.0, 0.025),
    (Tube((0.0, 0.0, 0.0), (0.0, 0.0, BASE_HEIGHT), 0.075),),
)  #: Fixed link of the arm, in `arm_base_link`; its frame is the base of the DH table


def tool_inertia(mass: float, centre: Vector = TOOL_CENTRE) -> Inertia:
    """Return the inertia of a tool with its load in the frame of the flange, `tool0` [kg, m].

    Args:
        mass: Mass [kg].
        centre: Centre of mass [m].
    """
    moment = mass * TOOL_GYRATION**2
    return Inertia(mass, (moment, moment, moment), centre)


def links(table: DhTable = UR5) -> tuple[Link, ...]:
    """Return the six moving links, from the base on; the frame of the last one is `tool0`."""
    t, zero, still = table, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    elbow_to_wrist = ELBOW_OFFSET - t.d4
    return (
        Link(
            "shoulder_link",
            (0.0, 0.0, t.d1),
            still,
            MOVING_MASSES[0],
            (0.0, -0.00193, -0.02561),
            (
                Tube((0.0, 0.0, BASE_HEIGHT - t.d1), (0.0, 0.0, 0.06), 0.06),
                Tube(zero, (0.0, -SHOULDER_OFFSET, 0.0), 0.06),
            ),
        ),
        Link(
            "upper_arm_link",
            zero,
            (QUARTER_TURN, 0.0, 0.0),
            MOVING_MASSES[1],
            (0.5 * t.a2, 0.0, 0.11336),
            (
                Tube((0.0, 0.0, SHOULDER_OFFSET), (t.a2, 0.0, SHOULDER_OFFSET), 0.054),
                Tube((0.0, 0.0, SHOULDER_OFFSET - 0.06), (0.0, 0.0, SHOULDER_OFFSET + 0.06), 0.06),
                Tube((t.a2, 0.0, ELBOW_OFFSET), (t.a2, 0.0, SHOULDER_OFFSET + 0.06), 0.06),
            ),
        ),
        Link(
            "forearm_link",
            (t.a2, 0.0, 0.0),
            still,
            MOVING_MASSES[2],
            (0.15 + t.a3, 0.0, 0.0265),
            (
                Tube((0.0, 0.0, ELBOW_OFFSET), (t.a3, 0.0, ELBOW_OFFSET), 0.04),
                Tube((t.a3, 0.0, ELBOW_OFFSET - 0.045), (t.a3, 0.0, ELBOW_OFFSET + 0.045), 0.045),
            ),
        ),
        Link(
            "wrist_1_link",
            (t.a3, 0.0, t.d4),
            still,
            MOVING_MASSES[3],
            (0.0, -0.01634, -0.0018),
            (Tube((0.0, 0.0, elbow_to_wrist + 0.045), (0.0, 0.0, 0.045), 0.045),),
        ),
        Link(
            "wrist_2_link",
            (0.0, -t.d5, 0.0),
            (QUARTER_TURN, 0.0, 0.0),
            MOVING_MASSES[4],
            (0.0, 0.01634, -0.0018),
            (
                Tube((0.0, 0.0, 0.045 - t.d5), (0.0, 0.0, 0.045), 0.045),
                Tube(zero, (0.0, t.d6 - FLANGE, 0.0), 0.0375),
            ),
        ),
        Link(
            "wrist_3_link",
            (0.0, t.d6, 0.0),
            (-QUARTER_TURN, 0.0, 0.0),
            MOVING_MASSES[5],
            (0.0, 0.0, -0.001159),
            (Tube((0.0, 0.0, -FLANGE), zero, 0.0375),),
        ),
    )
