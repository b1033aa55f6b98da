"""The arm: the links of the robot's description on hinges."""

from xml.etree.ElementTree import Element

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.platform import Platform
from omniman_ros.description.inertia import Inertia
from omniman_ros.description.ur5 import (
    ARM_MASS,
    BASE,
    ROTOR_INERTIAS,
    TOOL,
    Link,
    links,
    tool_inertia,
)
from omniman_ros.description.urdf import ARM_BASE
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.simulation.world.model.mjcf import (
    HINGE_FRICTION,
    ROBOT,
    ROBOT_GROUP,
    add,
    add_inertia,
)


def tool_of(robot: Platform) -> Inertia:
    """Return mass and centre of the arm's tool: what the robot's arm has beyond its links."""
    x, y, z = robot.arm.tool_centre
    return tool_inertia(max(robot.arm.mass - ARM_MASS, 0.0), (x, y, z))


def add_arm(base: Element, arm: ArmParameters, mount: Mount, tool: Inertia) -> None:
    """Add the arm to the platform."""
    position, rotation = (mount.x, mount.y, mount.z), (0.0, 0.0, mount.yaw)
    parent = add(base, "body", name=ARM_BASE, pos=position, euler=rotation)
    parent = _add_link(parent, BASE)
    for name, link, rotor in zip(arm.joints, links(), ROTOR_INERTIAS, strict=True):
        parent = _add_link(parent, link)
        axis = (0.0, 0.0, 1.0)
        add(parent, "joint", name=name, axis=axis, armature=rotor, **HINGE_FRICTION)
    if tool.mass > 0.0:
        add_inertia(add(parent, "body", name=TOOL), tool)


def _add_link(parent: Element, link: Link) -> Element:
    body = add(parent, "body", name=link.name, pos=link.place, euler=link.rpy)
    add_inertia(body, link.inertia)
    for tube in link.tubes:
        add(
            body,
            "geom",
            type="cylinder",
            pos=tube.centre,
            euler=tube.rpy,
            size=(tube.radius, 0.5 * tube.length),
            contype=str(ROBOT),
            conaffinity="0",
            group=str(ROBOT_GROUP),
        )
    return body
