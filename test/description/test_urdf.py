"""Tests of the generated URDF with an independent reader of its tree and transforms."""

import io
import math
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np
import pytest

from omniman_ros.core.arm_model import ArmModel
from omniman_ros.core.arm_parameters import UR_JOINTS, ArmParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.description.inertia import wheel_masses
from omniman_ros.description.urdf import carries_arm, urdf
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from test import robots

ARM = ArmParameters()
MOUNT = Mount(x=0.21, y=-0.07, z=0.48, yaw=0.7)
UR5_MASS = 18.4  #: Mass of the UR5 in its data sheet [kg]
#: Masses of its moving links in the public description [kg]
MOVING_MASSES = (3.7, 8.393, 2.33, 1.219, 1.219, 0.1879)
RANDOM_ROBOTS = [(seed, n) for seed, n in enumerate([3, 4, 5, 6, 8] * 8)]


# ---- reader -------------------------------------------------------------------------------------


def numbers(element, key, default="0 0 0"):
    text = default if element is None else element.get(key, default)
    return np.array([float(word) for word in text.split()])


def rotation_about(axis, angle):
    """Return the rotation (3, 3) about a unit vector by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def pose(origin):
    """Return the transform (4, 4) of an <origin> with roll, pitch and yaw about fixed axes."""
    roll, pitch, yaw = numbers(origin, "rpy")
    result = np.eye(4)
    result[:3, :3] = (
        rotation_about([0, 0, 1], yaw)
        @ rotation_about([0, 1, 0], pitch)
        @ rotation_about([1, 0, 0], roll)
    )
    result[:3, 3] = numbers(origin, "xyz")
    return result


@dataclass
class RigidBody:
    mass: float
    centre: np.ndarray
    tensor: np.ndarray


class UrdfTree:
    def __init__(self, text):
        self.root = ElementTree.fromstring(text)
        self.links = {link.get("name"): link for link in self.root.findall("link")}
        self.joints = {joint.get("name"): joint for joint in self.root.findall("joint")}
        self.parent_joints = {
            joint.find("child").get("link"): joint for joint in self.root.findall("joint")
        }

    def frame(self, link, angles=None):
        """Return the pose (4, 4) of a link in base_link."""
        if link == "base_link":
            return np.eye(4)
        joint = self.parent_joints[link]
        turned = np.eye(4)
        if joint.get("type") != "fixed":
            axis = numbers(joint.find("axis"), "xyz", "1 0 0")
            turned[:3, :3] = rotation_about(axis, (angles or {}).get(joint.get("name"), 0.0))
        before = self.frame(joint.find("parent").get("link"), angles)
        return before @ pose(joint.find("origin")) @ turned

    def body(self, link):
        """Return mass, centre and central inertia of a link in base_link, if any."""
        inertial = self.links[link].find("inertial")
        if inertial is None:
            return None
        xx, xy, xz, yy, yz, zz = (
            float(inertial.find("inertia").get(key))
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        placed = self.frame(link) @ pose(inertial.find("origin"))
        turn = placed[:3, :3]
        tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        return RigidBody(float(inertial.find("mass").get("value")), placed[:3, 3], tensor)

    @property
    def bodies(self):
        found = {name: self.body(name) for name in self.links}
        return {name: body for name, body in found.items() if body is not None}


def urdf_tree(name="omniman", arm=ARM, mount=MOUNT, **options):
    return UrdfTree(urdf(robots.robot(name), arm, mount, **options))


# ---- tree ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("with_arm", [True, False])
@pytest.mark.parametrize("name", robots.ALL)
def test_the_links_form_one_tree_with_unique_names(name, with_arm):
    root = urdf_tree(name, with_arm=with_arm).root
    links = [link.get("name") for link in root.findall("link")]
    joints = [joint.get("name") for joint in root.findall("joint")]
    children = [joint.find("child").get("link") for joint in root.findall("joint")]
    assert len(set(links)) == len(links) and len(set(joints)) == len(joints)
    assert sorted(["base_link", *children]) == sorted(links), (
        "each link except the root has one parent"
    )
    known = UrdfTree(ElementTree.tostring(root))
    for link in links:
        known.frame(link)  # a link outside the tree raises a KeyError
    materials = {material.get("name") for material in root.findall("material")}
    assert {used.get("name") for used in root.iter("material")} == materials


def test_a_robot_has_an_arm_if_its_file_specifies_an_arm_mass():
    assert {name: carries_arm(robots.robot(name)) for name in robots.ALL} == {
        "omniman": True,
        "ig42": False,
        "omni3": False,
        "mecanum6": True,
        "skewed4": True,
        "mecanum8": True,
    }
    assert set(UR_JOINTS) <= set(urdf_tree("omniman").joints)
    assert "arm_base_link" not in urdf_tree("ig42").links
    assert "arm_base_link" not in urdf_tree("omniman", with_arm=False).links
    assert set(UR_JOINTS) <= set(urdf_tree("ig42", with_arm=True).joints)


def test_the_robot_name_is_configurable_and_escaped():
    assert urdf_tree(name="omniman").root.get("name") == "omniman"
    text = urdf(robots.robot("omniman"), ARM, MOUNT, name='a<b>&"c"')
    assert ElementTree.fromstring(text).get("name") == 'a<b>&"c"'


# ---- kinematics ---------------------------------------------------------------------------------


def test_the_pose_of_tool0_agrees_with_the_kinematic_model():
    rng = np.random.default_rng(80)
    worst = 0.0
    for k in range(1000):
        if k % 100 == 0:
            x, y, z, yaw = rng.uniform([-1, -1, 0.2, -3], [1, 1, 1, 3])
            mount = Mount(x=x, y=y, z=z, yaw=yaw)
            described, model = urdf_tree(mount=mount), WholeBodyModel(mount)
        q = rng.uniform(-math.tau, math.tau, 6)
        found = described.frame("tool0", dict(zip(UR_JOINTS, q, strict=True)))
        worst = max(worst, np.abs(found - model.forward(np.concatenate([np.zeros(3), q]))).max())
    assert worst < 1e-9


def test_link_origins_agree_with_the_public_description():
    """Each link has the origin of a DH frame, and the arm at zero is stretched forward."""
    q = np.random.default_rng(81).uniform(-3, 3, 6)
    described, model = urdf_tree(mount=Mount(x=0.0, z=0.5)), ArmModel()
    angles = dict(zip(UR_JOINTS, q, strict=True))
    base = described.frame("arm_base_link_inertia")
    frames = base @ model.frames(q)
    shoulder, elbow, wrist, tool = (frames[i, :3, 3] for i in (1, 2, 3, 6))
    for link, place in (
        ("shoulder_link", shoulder),
        ("upper_arm_link", shoulder),
        ("forearm_link", elbow),
        ("wrist_3_link", tool),
        ("tool0", tool),
    ):
        assert described.frame(link, angles)[:3, 3] == pytest.approx(place, abs=1e-12)
    wrist_1 = described.frame("wrist_1_link", angles)
    assert wrist_1[:3, 3] == pytest.approx(wrist + 0.10915 * wrist_1[:3, 2], abs=1e-12)
    assert described.frame("tool0")[0, 3] == pytest.approx(0.425 + 0.39225)


def test_base_and_flange_have_the_orientations_of_ur_description():
    """`base` is the frame of the controller's poses; the flange's x points along z of `tool0`."""
    described = urdf_tree()
    base = described.frame("arm_base_link_inertia")
    assert described.frame("base") == pytest.approx(base, abs=1e-12), "the frame of the DH model"
    flange, tool = described.frame("flange"), described.frame("tool0")
    expected = tool[:, [2, 0, 1, 3]]
    assert flange == pytest.approx(expected, abs=1e-12)


def test_the_arm_is_on_its_mount_with_its_dh_base_turned_by_half_a_revolution():
    described = urdf_tree()
    assert np.array_equal(described.frame("arm_base_link"), MOUNT.pose)
    turned = np.linalg.inv(MOUNT.pose) @ described.frame("arm_base_link_inertia")
    assert turned == pytest.approx(np.diag([-1.0, -1.0, 1.0, 1.0]), abs=1e-15)


@pytest.mark.parametrize("name", robots.ALL)
def test_a_wheel_at_positive_speed_rolls_along_its_heading(name):
    described, wheels = urdf_tree(name), robots.robot(name).wheels
    rolling = [j for j in described.joints.values() if j.get("type") == "continuous"]
    assert tuple(joint.get("name") for joint in rolling) == wheels.joints
    for joint, x, y, heading, radius in zip(
        rolling, wheels.x, wheels.y, wheels.heading, wheels.radius, strict=True
    ):
        link = joint.find("child").get("link")
        frame = described.frame(link)
        assert frame[:3, 3] == pytest.approx([x, y, radius])
        axle = frame[:3, :3] @ numbers(joint.find("axis"), "xyz")
        # The tyre moves backward at the floor as fast as the hub moves forward.
        at_floor = np.cross(axle, [0.0, 0.0, -radius])
        forward = np.array([math.cos(heading), math.sin(heading), 0.0])
        assert at_floor == pytest.approx(-radius * forward, abs=1e-12)
        tyre = described.links[link].find("collision")
        round_about = (frame @ pose(tyre.find("origin")))[:3, 2]
        assert np.abs(round_about @ axle) == pytest.approx(1.0), "the cylinder lies on its side"
        assert float(tyre.find("geometry/cylinder").get("radius")) == radius


# ---- limits -------------------------------------------------------------------------------------


def test_joint_limits_are_those_of_the_parameters():
    arm = ArmParameters(
        joints=tuple(f"left_{name}" for name in UR_JOINTS),
        lower=(-1.0, -1.1, -1.2, -1.3, -1.4, -1.5),
        upper=(2.0,),
        velocity=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
    )
    described = urdf_tree(arm=arm)
    for i, (name, effort) in enumerate(zip(arm.joints, [150.0] * 3 + [28.0] * 3, strict=True)):
        joint = described.joints[name]
        assert joint.get("type") == "revolute"
        limit = {key: float(text) for key, text in joint.find("limit").items()}
        assert limit == {
            "lower": arm.lower[i],
            "upper": 2.0,
            "velocity": arm.velocity[i],
            "effort": effort,
        }


def test_wheels_have_the_speed_torque_and_friction_of_the_robot():
    changes = {"friction.viscous": [0.1, 0.2, 0.3, 0.4], "friction.coulomb": [1.0, 2.0, 3.0, 4.0]}
    robot = robots.robot("omniman", changes)
    described = UrdfTree(urdf(robot, ARM, MOUNT))
    for i, name in enumerate(robot.wheels.joints):
        limit = described.joints[name].find("limit")
        assert float(limit.get("velocity")) == 14.0
        assert float(limit.get("effort")) == pytest.approx(0.11 * 25.0 * 25.0 * 0.8)
        dynamics = described.joints[name].find("dynamics")
        assert float(dynamics.get("damping")) == robot.friction.viscous[i]
        assert float(dynamics.get("friction")) == robot.friction.coulomb[i]


# ---- masses -------------------------------------------------------------------------------------

ALL_ROBOTS = [robots.robot(name) for name in robots.ALL] + [
    robots.random_robot(np.random.default_rng(seed), n) for seed, n in RANDOM_ROBOTS
]


@pytest.mark.parametrize("robot", ALL_ROBOTS, ids=range(len(ALL_ROBOTS)))
def test_every_link_is_a_physically_possible_body(robot):
    bodies = UrdfTree(urdf(robot, ARM, MOUNT, with_arm=True)).bodies
    assert len(bodies) == 1 + robot.wheel_count + 7
    for name, body in bodies.items():
        moments = np.linalg.eigvalsh(body.tensor)
        assert body.mass > 0.0, name
        assert moments[0] > 0.0, name
        assert moments[2] < moments[0] + moments[1], f"{name}: the triangle inequality"


@pytest.mark.parametrize("robot", ALL_ROBOTS, ids=range(len(ALL_ROBOTS)))
def test_the_platform_has_the_mass_centre_and_inertia_of_the_body(robot):
    described = UrdfTree(urdf(robot, ARM, MOUNT, with_arm=False))
    bodies, body = described.bodies, robot.body
    assert sum(part.mass for part in bodies.values()) == pytest.approx(body.mass)
    centre = sum(part.mass * part.centre for part in bodies.values()) / body.mass
    assert centre[:2] == pytest.approx([body.com_x, body.com_y], abs=1e-9)
    # The inertia parameter treats the wheels as point masses.
    away = {name: np.hypot(*(part.centre - centre)[:2]) for name, part in bodies.items()}
    upright = sum(part.mass * away[name] ** 2 for name, part in bodies.items())
    assert upright + bodies["base_link"].tensor[2, 2] == pytest.approx(body.inertia)


@pytest.mark.parametrize("robot", ALL_ROBOTS, ids=range(len(ALL_ROBOTS)))
def test_wheels_have_the_configured_inertia_about_their_axles(robot):
    described = UrdfTree(urdf(robot, ARM, MOUNT))
    for name, inertia in zip(robot.wheels.names, robot.wheels.inertia, strict=True):
        tensor = described.links[f"{name}_wheel"].find("inertial/inertia")
        assert float(tensor.get("iyy")) == inertia


def test_wheels_weigh_as_solid_cylinders_unless_the_body_is_too_light():
    robot = robots.robot("mecanum8")
    assert wheel_masses(robot) == pytest.approx([2.0 * 0.08 / 0.127**2] * 8)
    light = replace(robot, body=replace(robot.body, mass=40.0))
    assert wheel_masses(light) == pytest.approx([0.5 * 40.0 / 8] * 8)
    small = replace(robot, body=replace(robot.body, inertia=10.0))
    assert sum(wheel_masses(small)) < 0.5 * 8 * 2.0 * 0.08 / 0.127**2


def test_the_arm_has_the_masses_of_the_public_description_and_of_the_data_sheet():
    with_arm, without = (urdf_tree("omniman", with_arm=flag).bodies for flag in (True, False))
    more = {name: body.mass for name, body in with_arm.items() if name not in without}
    moving = list(more.values())[-len(MOVING_MASSES) :]
    assert moving == pytest.approx(MOVING_MASSES)
    assert sum(more.values()) == pytest.approx(UR5_MASS)
    assert sum(body.mass for body in with_arm.values()) == pytest.approx(140.0 + UR5_MASS)


# ---- shapes -------------------------------------------------------------------------------------


def collision_boxes(described):
    """Yield the lower and upper corner of each collision box of the body."""
    for collision in described.links["base_link"].findall("collision"):
        centre = numbers(collision.find("origin"), "xyz")
        half = 0.5 * numbers(collision.find("geometry/box"), "size")
        yield centre - half, centre + half


@pytest.mark.parametrize("height", [0.05, 0.2, 0.27, 0.3, 0.5, 1.2])
@pytest.mark.parametrize("name", robots.ALL)
def test_the_body_is_between_floor_and_mount(name, height):
    for lower, upper in collision_boxes(urdf_tree(name, mount=Mount(z=height), with_arm=True)):
        assert (upper > lower).all()
        assert lower[2] > 0.0
        assert upper[2] <= height + 1e-12


def test_the_body_has_the_length_and_width_of_the_base_box():
    lower, upper = next(collision_boxes(urdf_tree("omniman")))
    assert upper[:2] - lower[:2] == pytest.approx([1.0, 0.7])


@pytest.mark.parametrize("robot", ALL_ROBOTS, ids=range(len(ALL_ROBOTS)))
def test_the_body_does_not_intersect_the_wheels(robot):
    described, wheels = UrdfTree(urdf(robot, ARM, MOUNT, with_arm=False)), robot.wheels
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 21)] * 3), axis=-1).reshape(-1, 3)
    for wheel, radius in zip(wheels.names, wheels.radius, strict=True):
        link = f"{wheel}_wheel"
        width = described.links[link].find("collision/geometry/cylinder").get("length")
        frame = described.frame(link)
        points = grid * [radius, 0.5 * float(width), radius] @ frame[:3, :3].T + frame[:3, 3]
        for lower, upper in collision_boxes(described):
            assert not ((points > lower) & (points < upper)).all(axis=1).any()


# ---- refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "joints", "message"),
    [
        (["a", "b", "c", "d"], UR_JOINTS[:5], "must be the 6 joints of a UR5"),
        (["a", "b", "c", "elbow_joint"], UR_JOINTS, "'elbow_joint' is also a wheel"),
        (["a", "b", "c", "d\x00"], UR_JOINTS, "characters that XML does not allow"),
        (
            ["a", "b", "c", "a_wheel_joint"],
            UR_JOINTS,
            "two joints would have the same name",
        ),
    ],
)
def test_names_that_are_invalid_in_a_urdf_are_refused(names, joints, message):
    robot = robots.robot("omniman", {"wheels.names": names})
    with pytest.raises(ParameterError, match=message):
        urdf(robot, ArmParameters(joints=joints, lower=(-1.0,), upper=(1.0,)), MOUNT)


def test_a_robot_requires_a_name():
    with pytest.raises(ParameterError, match="printable"):
        urdf(robots.robot("omniman"), ARM, MOUNT, name="")


# ---- other readers ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", robots.ALL)
def test_pinocchio_reads_an_identical_robot(name):
    pin = pytest.importorskip("pinocchio")
    robot, model = robots.robot(name), WholeBodyModel(MOUNT)
    read = pin.buildModelFromXML(urdf(robot, ARM, MOUNT, with_arm=True))
    data = read.createData()
    tool = read.getFrameId("tool0")
    rng = np.random.default_rng(82)
    for _ in range(200):
        q = pin.neutral(read)
        angles = rng.uniform(-3, 3, 6)
        for joint, angle in zip(UR_JOINTS, angles, strict=True):
            q[read.joints[read.getJointId(joint)].idx_q] = angle
        pin.framesForwardKinematics(read, data, q)
        expected = model.forward(np.concatenate([np.zeros(3), angles]))
        assert np.abs(data.oMf[tool].homogeneous - expected).max() < 1e-9
    assert {*read.names} == {"universe", *UR_JOINTS, *robot.wheels.joints}
    moving = sum(inertia.mass for inertia in read.inertias)
    assert moving == pytest.approx(UR5_MASS + robot.body.mass)


@pytest.mark.parametrize("name", robots.ALL)
def test_yourdfpy_reads_the_urdf_without_warnings(name):
    reader = pytest.importorskip("yourdfpy")
    text = urdf(robots.robot(name), ARM, MOUNT, with_arm=True)
    read = reader.URDF.load(io.BytesIO(text.encode()))
    assert read.validate()
    assert read.base_link == "base_link"
    angles = np.random.default_rng(83).uniform(-3, 3, 6)
    read.update_cfg(dict(zip(UR_JOINTS, angles, strict=True)))
    expected = WholeBodyModel(MOUNT).forward(np.concatenate([np.zeros(3), angles]))
    assert np.abs(read.get_transform("tool0") - expected).max() < 1e-9
