"""URDF of the whole robot: platform, wheels, arm; simple shapes of ours.

The tree is `base_link` (on the floor, REP 105), a link for each wheel, and the arm's links with
their public names from `arm_base_link` to `tool0`. Joints are named as in `wheel_states` and
`arm/joint_states`. http://wiki.ros.org/urdf/XML
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from xml.etree import ElementTree as xml

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.body.model import Mount
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.robot import Robot
from omniman_ros.description.body import WHEEL_WIDTH, Box, body_boxes
from omniman_ros.description.inertia import Inertia, Vector, rest_of_body, wheel, wheel_masses
from omniman_ros.description.ur5 import BASE, EFFORTS, Link, Tube, links

ZERO = (0.0, 0.0, 0.0)
ON_SIDE = (1.5707963267948966, 0.0, 0.0)
"""Turn after which z is a wheel's axle [rad]."""
COLOURS = {
    "body": "0.22 0.26 0.31 1",
    "tyre": "0.10 0.10 0.11 1",
    "mark": "0.93 0.55 0.13 1",
    "metal": "0.72 0.75 0.78 1",
    "joint": "0.30 0.52 0.72 1",
}
"""Red, green, blue and opacity of what the robot is made of."""
MARK = (1.5, 1.02, 0.25)
"""Edges of the mark that shows a wheel turn: over its radius, its width, its radius."""
TOOL = "tool0"
ARM_BASE = "arm_base_link"


def carries_arm(robot: Robot) -> bool:
    """Whether the robot has an arm: whether `arm.mass` is more than 0."""
    return robot.arm.mass > 0.0


def demand_joints(robot: Robot, arm: ArmParameters) -> None:
    """Demand that the joints of wheels and arm have names of their own, which XML can have.

    Raises:
        ParameterError: A name is there twice or not printable, or the arm has not six joints.
    """
    if len(arm.joints) != len(EFFORTS):
        raise ParameterError("arm.joints", arm.joints, f"a UR5 has {len(EFFORTS)} joints")
    both = set(robot.wheels.names) & set(arm.joints)
    if both:
        raise ParameterError("arm.joints", arm.joints, f"'{min(both)}' is also a wheel")
    for label, names in (("wheels.names", robot.wheels.names), ("arm.joints", arm.joints)):
        for name in names:
            if not name.isprintable():
                raise ParameterError(label, names, f"{name!r} has characters that no XML has")


def urdf(
    robot: Robot,
    arm: ArmParameters,
    mount: Mount,
    name: str = "omniman",
    with_arm: bool | None = None,
) -> str:
    """The URDF of a robot as it is configured.

    Wheels have their mass from the body's, see :func:`wheel_masses`. The arm has the public
    masses of the UR5's links; `arm.mass` of the robot, which is the arm as the platform's control
    sees it, with tool and load, only says whether there is one.

    Args:
        robot: The platform, with any wheels.
        arm: Names and limits of the joints.
        mount: Where the arm stands.
        name: Of the robot.
        with_arm: Whether to describe the arm; None: if the robot carries one.

    Raises:
        ParameterError: Names of joints or links are there twice or cannot be written, or the arm
            has not six joints.
    """
    demand_joints(robot, arm)
    if not name.isprintable() or not name:
        raise ParameterError("name", name, "needs printable characters")
    armed = carries_arm(robot) if with_arm is None else with_arm
    root = xml.Element("robot", name=name)
    for colour, rgba in COLOURS.items():
        xml.SubElement(xml.SubElement(root, "material", name=colour), "color", rgba=rgba)
    _add_platform(root, robot, mount.z if armed else None)
    if armed:
        _add_arm(root, arm, mount)
    _demand_single(root)
    xml.indent(root)
    return '<?xml version="1.0"?>\n' + xml.tostring(root, encoding="unicode") + "\n"


def _demand_single(root: xml.Element) -> None:
    for kind, parameter in (("link", "wheels.names"), ("joint", "arm.joints")):
        names = Counter(element.get("name") for element in root.findall(kind))
        twice = [str(name) for name, count in names.items() if count > 1]
        if twice:
            raise ParameterError(parameter, tuple(twice), f"there would be two {kind}s of a name")


# ---- platform -----------------------------------------------------------------------------------


def _add_platform(root: xml.Element, robot: Robot, mount: float | None) -> None:
    masses, boxes = wheel_masses(robot), body_boxes(robot, mount)
    deck = boxes[0]
    bottom, top = (deck.centre[2] + side * 0.5 * deck.size[2] for side in (-1.0, 1.0))
    base = xml.SubElement(root, "link", name="base_link")
    _add_inertia(base, rest_of_body(robot, masses, bottom, top))
    for box in boxes:
        _add_shape(base, "body", "box", {"size": box.size}, box.centre)
    for i, mass in enumerate(masses):
        _add_wheel(root, robot, i, mass)


def _add_wheel(root: xml.Element, robot: Robot, i: int, mass: float) -> None:
    """A wheel that rolls to its x: it turns about its y, right-handed."""
    wheels, motor = robot.wheels, robot.motor
    name, radius = wheels.names[i], wheels.radius[i]
    width = WHEEL_WIDTH * radius
    link = xml.SubElement(root, "link", name=f"{name}_wheel")
    _add_inertia(link, wheel(robot, i, mass, width))
    _add_shape(link, "tyre", "cylinder", {"radius": radius, "length": width}, rpy=ON_SIDE)
    mark = Box(ZERO, (MARK[0] * radius, MARK[1] * width, MARK[2] * radius))
    _add_shape(link, "mark", "box", {"size": mark.size}, collides=False)
    joint = _add_joint(
        root, name, "continuous", "base_link", f"{name}_wheel",
        (wheels.x[i], wheels.y[i], radius), (0.0, 0.0, wheels.heading[i]), (0.0, 1.0, 0.0),
    )  # fmt: skip
    torque = motor.torque_constant * motor.max_current * motor.gear_ratio * motor.gear_efficiency
    _add(joint, "limit", effort=torque, velocity=motor.max_speed)
    friction = robot.friction
    _add(joint, "dynamics", damping=friction.viscous[i], friction=friction.coulomb[i])


# ---- arm ----------------------------------------------------------------------------------------


def _add_arm(root: xml.Element, arm: ArmParameters, mount: Mount) -> None:
    xml.SubElement(root, "link", name=ARM_BASE)
    _add_joint(
        root, f"base_link-{ARM_BASE}", "fixed", "base_link", ARM_BASE,
        (mount.x, mount.y, mount.z), (0.0, 0.0, mount.yaw),
    )  # fmt: skip
    _add_arm_link(root, BASE)
    _add_joint(root, f"{ARM_BASE}-{BASE.name}", "fixed", ARM_BASE, BASE.name, BASE.place, BASE.rpy)
    limits = zip(*(arm.each(label) for label in ("lower", "upper", "velocity")), strict=True)
    parent = BASE.name
    for joint_name, link, effort, (lower, upper, velocity) in zip(
        arm.joints, links(), EFFORTS, limits, strict=True
    ):
        _add_arm_link(root, link)
        joint = _add_joint(
            root, joint_name, "revolute", parent, link.name, link.place, link.rpy, (0.0, 0.0, 1.0)
        )
        _add(joint, "limit", lower=lower, upper=upper, effort=effort, velocity=velocity)
        parent = link.name
    xml.SubElement(root, "link", name=TOOL)
    _add_joint(root, f"{parent}-{TOOL}", "fixed", parent, TOOL, ZERO, ZERO)


def _add_arm_link(root: xml.Element, link: Link) -> None:
    element = xml.SubElement(root, "link", name=link.name)
    _add_inertia(element, link.inertia)
    for i, tube in enumerate(link.tubes):
        _add_tube(element, "joint" if i else "metal", tube)


def _add_tube(link: xml.Element, colour: str, tube: Tube) -> None:
    size = {"radius": tube.radius, "length": tube.length}
    _add_shape(link, colour, "cylinder", size, tube.centre, tube.rpy)


# ---- elements -----------------------------------------------------------------------------------


def _text(value: float | Iterable[float]) -> str:
    """Numbers in full: read again they are the same."""
    values: Iterable[float] = [value] if isinstance(value, float | int) else value
    return " ".join(repr(float(number) + 0.0) for number in values)


def _add(parent: xml.Element, tag: str, **values: float | Sequence[float]) -> xml.Element:
    return xml.SubElement(parent, tag, {key: _text(value) for key, value in values.items()})


def _add_inertia(link: xml.Element, inertia: Inertia) -> None:
    element = xml.SubElement(link, "inertial")
    _add(element, "origin", xyz=inertia.centre, rpy=inertia.rpy)
    _add(element, "mass", value=inertia.mass)
    x, y, z = inertia.moments
    _add(element, "inertia", ixx=x, ixy=0.0, ixz=0.0, iyy=y, iyz=0.0, izz=z)


def _add_shape(
    link: xml.Element, colour: str, shape: str, size: Mapping[str, float | Vector],
    xyz: Vector = ZERO, rpy: Vector = ZERO, *, collides: bool = True,
) -> None:  # fmt: skip
    for tag in ("visual", "collision") if collides else ("visual",):
        element = xml.SubElement(link, tag)
        _add(element, "origin", xyz=xyz, rpy=rpy)
        _add(xml.SubElement(element, "geometry"), shape, **size)
        if tag == "visual":
            xml.SubElement(element, "material", name=colour)


def _add_joint(
    root: xml.Element, name: str, kind: str, parent: str, child: str, xyz: Vector, rpy: Vector,
    axis: Vector | None = None,
) -> xml.Element:  # fmt: skip
    joint = xml.SubElement(root, "joint", name=name, type=kind)
    _add(joint, "origin", xyz=xyz, rpy=rpy)
    xml.SubElement(joint, "parent", link=parent)
    xml.SubElement(joint, "child", link=child)
    if axis is not None:
        _add(joint, "axis", xyz=axis)
    return joint
