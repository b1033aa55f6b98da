"""URDF of the whole robot: platform, wheels and arm, in simple shapes of our own.

The tree is `base_link` (on the floor, REP 105), a link for each wheel, and the arm's links with
their public names from `arm_base_link` to `tool0`, with the frames `base` of the arm's controller
and `flange` as ur_description has them. Joints are named as in `wheel_states` and
`arm/joint_states`. http://wiki.ros.org/urdf/XML
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from xml.etree import ElementTree

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.platform import Platform
from omniman_ros.description.inertia import Inertia, Vector, rest_of_body, wheel, wheel_masses
from omniman_ros.description.platform_shape import WHEEL_WIDTH, Box, platform_boxes
from omniman_ros.description.ur5 import BASE, EFFORTS, Link, Tube, links
from omniman_ros.motion.whole_body.model import Mount

ZERO = (0.0, 0.0, 0.0)  #: Zero vector: no translation [m], or no rotation [rad]
WHEEL_RPY = (1.5707963267948966, 0.0, 0.0)  #: Rotation after which z is a wheel's axle [rad]
#: Rotation from the arm's base to `base`, in which the arm's controller gives its poses [rad]
CONTROLLER_BASE_RPY = (0.0, 0.0, 3.141592653589793)
#: Rotation from the last link to `flange`, whose x points out of the arm (REP 199) [rad]
FLANGE_RPY = (0.0, -1.5707963267948966, -1.5707963267948966)
#: Rotation from `flange` to `tool0`, which has the orientation of the last link [rad]
TOOL_RPY = (1.5707963267948966, 0.0, 1.5707963267948966)
COLOURS = {
    "body": "0.22 0.26 0.31 1",
    "tyre": "0.10 0.10 0.11 1",
    "mark": "0.93 0.55 0.13 1",
    "metal": "0.72 0.75 0.78 1",
    "joint": "0.30 0.52 0.72 1",
}  #: Red, green, blue and opacity of the robot's materials
#: Edges of the mark that makes a wheel's rotation visible, over its radius, width and radius
WHEEL_MARK = (1.5, 1.02, 0.25)
TOOL = "tool0"  #: Name of the tool's link
ARM_BASE = "arm_base_link"  #: Name of the link of the arm's base


def carries_arm(robot: Platform) -> bool:
    """Return whether the robot has an arm, that is, whether `arm.mass` is above 0."""
    return robot.arm.mass > 0.0


def require_joint_names(robot: Platform, arm: ArmParameters) -> None:
    """Require that the joints of wheels and arm have unique names that XML allows.

    Raises:
        ParameterError: A name is used twice or not printable, or the arm has not six joints.
    """
    if len(arm.joints) != len(EFFORTS):
        raise ParameterError(
            "arm.joints", arm.joints, f"must be the {len(EFFORTS)} joints of a UR5"
        )
    shared = {*robot.wheels.names, *robot.wheels.joints} & set(arm.joints)
    if shared:
        raise ParameterError("arm.joints", arm.joints, f"'{min(shared)}' is also a wheel")
    for label, names in (("wheels.names", robot.wheels.names), ("arm.joints", arm.joints)):
        for name in names:
            if not name.isprintable():
                raise ParameterError(
                    label, names, f"{name!r} has characters that XML does not allow"
                )


def urdf(
    robot: Platform,
    arm: ArmParameters,
    mount: Mount,
    name: str = "omniman",
    with_arm: bool | None = None,
) -> str:
    """Return the URDF of a robot as it is configured.

    The mass of the wheels is part of the body's, see :func:`wheel_masses`. The arm has the public
    masses of the UR5's links; `arm.mass` of the robot, which is the arm with tool and load as the
    platform's control sees it, only determines whether there is an arm.

    Args:
        robot: The platform, with any number of wheels.
        with_arm: Whether to describe the arm; None means if the robot carries one.

    Raises:
        ParameterError: Names of joints or links are used twice or cannot be written, or the arm
            has not six joints.
    """
    require_joint_names(robot, arm)
    if not name.isprintable() or not name:
        raise ParameterError("name", name, "must have printable characters")
    armed = carries_arm(robot) if with_arm is None else with_arm
    root = ElementTree.Element("robot", name=name)
    for colour, rgba in COLOURS.items():
        ElementTree.SubElement(
            ElementTree.SubElement(root, "material", name=colour), "color", rgba=rgba
        )
    _add_platform(root, robot, mount.z if armed else None)
    if armed:
        _add_arm(root, arm, mount)
    _require_unique_names(root)
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _require_unique_names(root: ElementTree.Element) -> None:
    for kind, parameter in (("link", "wheels.names"), ("joint", "arm.joints")):
        names = Counter(element.get("name") for element in root.findall(kind))
        repeated = tuple(str(name) for name, count in names.items() if count > 1)
        if repeated:
            raise ParameterError(parameter, repeated, f"two {kind}s would have the same name")


# ---- platform -----------------------------------------------------------------------------------


def _add_platform(root: ElementTree.Element, robot: Platform, mount: float | None) -> None:
    """Add the platform's body, below an arm at a height `mount` [m], and its wheels."""
    masses, boxes = wheel_masses(robot), platform_boxes(robot, mount)
    deck = boxes[0]
    bottom, top = (deck.centre[2] + side * 0.5 * deck.size[2] for side in (-1.0, 1.0))
    base = ElementTree.SubElement(root, "link", name="base_link")
    _add_inertia(base, rest_of_body(robot, masses, bottom, top))
    for box in boxes:
        _add_shape(base, "body", "box", {"size": box.size}, box.centre, (0.0, 0.0, box.yaw))
    for i, mass in enumerate(masses):
        _add_wheel(root, robot, i, mass)


def _add_wheel(root: ElementTree.Element, robot: Platform, i: int, mass: float) -> None:
    """Add a wheel that rolls towards its x: it rotates about its y, right-handed."""
    wheels, motor = robot.wheels, robot.motor
    name, radius = wheels.names[i], wheels.radius[i]
    width = WHEEL_WIDTH * radius
    link = ElementTree.SubElement(root, "link", name=f"{name}_wheel")
    _add_inertia(link, wheel(robot, i, mass, width))
    _add_shape(link, "tyre", "cylinder", {"radius": radius, "length": width}, rpy=WHEEL_RPY)
    mark = Box(ZERO, (WHEEL_MARK[0] * radius, WHEEL_MARK[1] * width, WHEEL_MARK[2] * radius))
    _add_shape(link, "mark", "box", {"size": mark.size}, collides=False)
    joint = _add_joint(
        root,
        wheels.joints[i],
        "continuous",
        "base_link",
        f"{name}_wheel",
        (wheels.x[i], wheels.y[i], radius),
        (0.0, 0.0, wheels.heading[i]),
        (0.0, 1.0, 0.0),
    )
    torque = motor.torque_constant * motor.max_current * motor.gear_ratio * motor.gear_efficiency
    _add(joint, "limit", effort=torque, velocity=motor.max_speed)
    friction = robot.friction
    _add(joint, "dynamics", damping=friction.viscous[i], friction=friction.coulomb[i])


# ---- arm ----------------------------------------------------------------------------------------


def _add_arm(root: ElementTree.Element, arm: ArmParameters, mount: Mount) -> None:
    ElementTree.SubElement(root, "link", name=ARM_BASE)
    _add_joint(
        root,
        f"base_link-{ARM_BASE}",
        "fixed",
        "base_link",
        ARM_BASE,
        (mount.x, mount.y, mount.z),
        (0.0, 0.0, mount.yaw),
    )
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
    for start, end, rpy in (
        (ARM_BASE, "base", CONTROLLER_BASE_RPY),
        (parent, "flange", FLANGE_RPY),
        ("flange", TOOL, TOOL_RPY),
    ):
        ElementTree.SubElement(root, "link", name=end)
        _add_joint(root, f"{start}-{end}", "fixed", start, end, ZERO, rpy)


def _add_arm_link(root: ElementTree.Element, link: Link) -> None:
    element = ElementTree.SubElement(root, "link", name=link.name)
    _add_inertia(element, link.inertia)
    for i, tube in enumerate(link.tubes):
        _add_tube(element, "joint" if i else "metal", tube)


def _add_tube(link: ElementTree.Element, colour: str, tube: Tube) -> None:
    size = {"radius": tube.radius, "length": tube.length}
    _add_shape(link, colour, "cylinder", size, tube.centre, tube.rpy)


# ---- elements -----------------------------------------------------------------------------------


def _text(value: float | Iterable[float]) -> str:
    """Format numbers so that reading them gives the same values."""
    values: Iterable[float] = [value] if isinstance(value, float | int) else value
    return " ".join(repr(float(number) + 0.0) for number in values)


def _add(
    parent: ElementTree.Element, tag: str, **values: float | Sequence[float]
) -> ElementTree.Element:
    """Add an element whose attributes are numbers or lists of numbers."""
    return ElementTree.SubElement(
        parent, tag, {key: _text(value) for key, value in values.items()}
    )


def _add_inertia(link: ElementTree.Element, inertia: Inertia) -> None:
    """Add mass, centre of mass and moments of inertia to a link."""
    element = ElementTree.SubElement(link, "inertial")
    _add(element, "origin", xyz=inertia.centre, rpy=inertia.rpy)
    _add(element, "mass", value=inertia.mass)
    x, y, z = inertia.moments
    _add(element, "inertia", ixx=x, ixy=0.0, ixz=0.0, iyy=y, iyz=0.0, izz=z)


def _add_shape(
    link: ElementTree.Element,
    colour: str,
    shape: str,
    size: Mapping[str, float | Vector],
    xyz: Vector = ZERO,
    rpy: Vector = ZERO,
    *,
    collides: bool = True,
) -> None:
    """Add a shape to a link, to be seen and, if `collides`, for collisions."""
    for tag in ("visual", "collision") if collides else ("visual",):
        element = ElementTree.SubElement(link, tag)
        _add(element, "origin", xyz=xyz, rpy=rpy)
        _add(ElementTree.SubElement(element, "geometry"), shape, **size)
        if tag == "visual":
            ElementTree.SubElement(element, "material", name=colour)


def _add_joint(
    root: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    xyz: Vector,
    rpy: Vector,
    axis: Vector | None = None,
) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    _add(joint, "origin", xyz=xyz, rpy=rpy)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    if axis is not None:
        _add(joint, "axis", xyz=axis)
    return joint
