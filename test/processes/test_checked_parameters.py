"""Files and parameters that a node would refuse are refused before a process is started."""

import pytest

from omniman_ros import extras
from omniman_ros.console.errors import CommandError
from omniman_ros.core.errors import FileError, GeometryError, ParameterError
from omniman_ros.processes.checked_parameters import check_node, robot_values
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes
from omniman_ros.robots import robot_file

HEAD = "/**:\n  ros__parameters:\n"


@pytest.fixture
def robot(tmp_path):
    """Return a function that writes a robot's file with a change, and returns its path."""

    def write(old, new):
        text = robot_file("ig42").read_text()
        assert old in text
        path = tmp_path / "mine.yaml"
        path.write_text(text.replace(old, new))
        return str(path)

    return write


def test_a_mistyped_name_in_a_robot_file_is_refused(robot):
    with pytest.raises(ParameterError, match=r"'wheels.raduis', did you mean 'wheels.radius'"):
        robot_values(robot("  radius:", "  raduis:"))


def test_a_platform_that_cannot_move_every_way_is_refused(robot):
    with pytest.raises(GeometryError):
        robot_values("ig42", None, {"wheels.roller_angle": [0.0]})
    file = robot("roller_angle: [", "roller_angle: [0.0] # ")
    with pytest.raises(CommandError, match=f"robot '{file}': "):
        check_node("platform_controller", "", ["-p", f"robot:={file}"])


def test_values_go_before_a_file_and_that_before_the_robot(tmp_path, capsys):
    file = tmp_path / "more.yaml"
    file.write_text(HEAD + "    body.mass: 31\n    body.com_x: 0.01\n    bdy.mass: 3\n")
    values = robot_values("ig42", str(file), {"body.com_x": 0.02})
    assert (values["body.mass"], values["body.com_x"]) == (31, 0.02)
    assert "did you mean 'body.mass'" in capsys.readouterr().err


def test_a_file_for_some_nodes_describes_no_robot(tmp_path):
    file = tmp_path / "more.yaml"
    file.write_text("platform_controller:\n  ros__parameters: {body.mass: 31}\n")
    with pytest.raises(FileError, match=r"more\.yaml: has no"):
        robot_values("ig42", str(file))


def test_a_refused_value_is_named_with_where_it_is_from(tmp_path, robot):
    file = tmp_path / "more.yaml"
    file.write_text("/ns/platform_controller:\n  ros__parameters: {limits.linear_velocity: -1}\n")
    arguments = ["--ros-args", "-p", "robot:=ig42", "--params-file", str(file)]
    check_node("platform_controller", "", arguments)
    check_node("mpc_planner", "ns", arguments)
    with pytest.raises(CommandError, match=f"^{file}: .*'limits.linear_velocity' = -1.*below"):
        check_node("platform_controller", "/ns/", arguments)
    check_node("platform_controller", "ns", [*arguments, "-p", "limits.linear_velocity:=1e-1"])
    with pytest.raises(CommandError, match=r"^parameter 'body\.mass' = '3kg'"):
        check_node("platform_controller", "", ["-p", "body.mass:=3kg"])
    mine = robot("mass: 25.0", "mass: 25kg")
    with pytest.raises(CommandError, match=f"^robot '{mine}': parameter 'body.mass'"):
        check_node("platform_controller", "", ["-p", f"robot:={mine}"])


def test_an_array_without_items_is_given_as_ros_writes_it():
    check_node("simulated_drive", "", ["-p", "faults.stuck_wheel:=['']"])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("robot", b"/**:\n  ros__parameters:\n    a: [1\n", "mine.yaml:4: did not find"),
        ("robot", b"", "mine.yaml: its only section must be"),
        ("robot", "# grün\n".encode("latin-1"), "mine.yaml:1: is neither UTF-8 nor UTF-16"),
        ("params_file", b"/**:\n  ros__parameters:\n    a: [1, 2.0]\n", "mine.yaml:3: 'a' mixes"),
        ("params_file", b"- 1\n", "mine.yaml:1: has no"),
        ("installation", b"a: [\n", "mine.yaml:2: "),
        ("controller", b"a: [\n", "mine.yaml:2: "),
        ("world", b"walls: [\n", "mine.yaml:2: "),
        ("world", b"walls: [{x: 1}]\n", "mine.yaml"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_before_the_start(
    tmp_path, monkeypatch, name, content, message
):
    monkeypatch.setattr(extras, "find_spec", lambda name: object())
    file = tmp_path / "mine.yaml"
    file.write_bytes(content)
    more = {"installation": {"drive": "can"}, "controller": {"arm": "ur"}}.get(name, {})
    with pytest.raises(CommandError, match=message) as error:
        robot_processes(RobotSetup(**{name: str(file)}, **more))
    assert error.value.code == 2
    assert "\n" not in str(error.value)
