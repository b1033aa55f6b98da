"""SRDF of the robot: groups of joints, the platform's planar joint, and unchecked collisions.

http://docs.ros.org/en/jazzy and https://moveit.picknik.ai describe the elements.
"""

from collections.abc import Iterable
from xml.etree import ElementTree

from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.urdf import ARM_BASE, TOOL
from omniman_ros.motion.axes import PLANAR_JOINT
from omniman_ros.moveit.link_pairs import UncheckedPair

ARM, BASE, WHOLE_BODY = "arm", "base", "whole_body"
"""Names of the groups."""


def srdf(
    description: DescriptionParameters, pairs: Iterable[UncheckedPair], name: str = "omniman"
) -> str:
    """Return the SRDF of a robot with an arm; its name is that in its URDF."""
    root = ElementTree.Element("robot", name=name)

    def add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
        return ElementTree.SubElement(parent, tag, attributes)

    add(add(root, "group", name=ARM), "chain", base_link=ARM_BASE, tip_link=TOOL)
    add(add(root, "group", name=BASE), "joint", name=PLANAR_JOINT)
    whole_body = add(root, "group", name=WHOLE_BODY)
    for group in (BASE, ARM):
        add(whole_body, "group", name=group)
    add(
        root,
        "virtual_joint",
        name=PLANAR_JOINT,
        type="planar",
        parent_frame="odom",
        child_link="base_link",
    )
    for joint in description.robot.wheels.joints:
        add(root, "passive_joint", name=joint)
    for pair in pairs:
        reason = pair.reason.value
        add(root, "disable_collisions", link1=pair.first, link2=pair.second, reason=reason)
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
