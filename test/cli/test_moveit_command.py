"""Tests of `omniman moveit`."""

from xml.etree import ElementTree

import pytest
import yaml

from omniman_ros.cli.main import main


def test_the_files_of_a_configuration_are_written(capsys, tmp_path):
    folder = tmp_path / "made" / "config"
    assert main(["moveit", "--output", str(folder), "-p", "mount.z:=0.6"]) == 0
    assert str(folder) in capsys.readouterr().out
    for name in ("omniman.urdf", "omniman.srdf"):
        assert ElementTree.parse(folder / name).getroot().get("name") == "omniman"
    tables = {file.name: yaml.safe_load(file.read_text()) for file in folder.glob("*.yaml")}
    assert set(tables) == {
        "kinematics.yaml",
        "joint_limits.yaml",
        "moveit_controllers.yaml",
        "ompl_planning.yaml",
    }
    assert "arm" in tables["kinematics.yaml"]


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--robot", "ig42"], 2, "arm.mass"),
        (["-p", "mount.z:=high"], 2, "expected float"),
        (["--params-file", "/nowhere.yaml"], 2, "no parameter file '/nowhere.yaml'"),
        (["--output", "/proc/nowhere"], 1, "No such file or directory"),
    ],
)
def test_what_prevents_a_configuration_is_reported_in_one_line(words, code, message, capsys):
    assert main(["moveit", *words]) == code
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert message in error
