import subprocess
import sys
from xml.etree import ElementTree

import pytest

from omniman_ros.cli.main import main
from omniman_ros.core.arm_parameters import UR_JOINTS
from test import robots


def printed_urdf(capsys, *words):
    assert main(["urdf", *words]) == 0
    return ElementTree.fromstring(capsys.readouterr().out)


def joints(root):
    return {joint.get("name"): joint for joint in root.findall("joint")}


def test_the_urdf_has_the_joints_of_the_robot(capsys):
    assert {"front_left_wheel_joint", *UR_JOINTS} <= set(joints(printed_urdf(capsys)))
    assert "elbow_joint" not in joints(printed_urdf(capsys, "--robot", "ig42"))
    assert "rear_wheel_joint" in joints(printed_urdf(capsys, "--robot", robots.path("omni3")))


def test_parameters_of_robot_arm_and_mount_change_the_urdf(capsys):
    root = printed_urdf(
        capsys,
        "--robot",
        "ig42",
        "-p",
        "arm.mass:=18.4",
        "-p",
        "mount.z:=1",
        "-p",
        "arm.velocity:=[0.5]",
        "--param",
        "wheels.x:=[0.3, 0.3, -0.3, -0.3]",
    )
    found = joints(root)
    assert found["base_link-arm_base_link"].find("origin").get("xyz") == "0.2 0.0 1.0"
    assert {found[name].find("limit").get("velocity") for name in UR_JOINTS} == {"0.5"}
    assert found["front_left_wheel_joint"].find("origin").get("xyz").startswith("0.3 ")
    assert "elbow_joint" not in joints(printed_urdf(capsys, "-p", "arm.mass:=0.0"))


def test_parameters_on_the_command_line_take_precedence_over_a_file(capsys, tmp_path):
    file = tmp_path / "ur.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    ur: {host: 10.0.0.1}\n"
        "    arm: {velocity: [0.5], jerk: [9.0]}\n    mount: {x: 0.1}\n"
    )
    root = printed_urdf(capsys, "--params-file", str(file), "-p", "mount.x:=0.3")
    assert joints(root)["elbow_joint"].find("limit").get("velocity") == "0.5"
    assert joints(root)["base_link-arm_base_link"].find("origin").get("xyz") == "0.3 0.0 0.5"


def test_the_urdf_can_be_written_to_a_file(capsys, tmp_path):
    assert main(["urdf", "--output", str(tmp_path / "robot.urdf")]) == 0
    assert capsys.readouterr().out == ""
    written = (tmp_path / "robot.urdf").read_text()
    assert main(["urdf"]) == 0
    assert capsys.readouterr().out == written


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--robot", "nobody"], 2, "robot 'nobody': must be one of ig42, omniman"),
        (["-p", "mount.z=1"], 2, "'mount.z=1' is not NAME:=VALUE"),
        (["-p", "mount.z:="], 2, "is not NAME:=VALUE"),
        (["-p", "mount.height:=1"], 2, "'mount.height' does not affect the URDF"),
        (["-p", "mount.z:=high"], 2, "expected float"),
        (["-p", "mount.z:=6.0"], 2, "above the maximum 5 m"),
        (["-p", "mount.z:=[1"], 2, "is not YAML"),
        (["-p", "wheels.names:=[a, b, c, elbow_joint]"], 2, "is also a wheel"),
        (["--params-file", "/nowhere.yaml"], 2, "no parameter file '/nowhere.yaml'"),
        (["--output", "/nowhere/robot.urdf"], 1, "No such file or directory"),
    ],
)
def test_what_prevents_a_urdf_is_reported_in_one_line(words, code, message, capsys):
    assert main(["urdf", *words]) == code
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert message in error


@pytest.mark.processes
def test_the_urdf_needs_no_ros():
    code = (
        "import sys\n"
        "sys.modules['rclpy'] = None\n"
        "from omniman_ros.cli.main import main\n"
        "sys.exit(main(['urdf']))\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert ElementTree.fromstring(ended.stdout).tag == "robot"
