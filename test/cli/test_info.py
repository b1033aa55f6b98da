"""`omniman info`: what it finds, and that it finds it without what may be missing."""

import subprocess
import sys
from pathlib import Path

import pytest

from omniman_ros.cli import info, installation
from omniman_ros.cli.installation import (
    Requirements,
    commit_text,
    extra_text,
    installation_text,
    parse_requirements,
)
from omniman_ros.cli.main import main

LINES = [
    "numpy",
    "mujoco-core==4.*,>=4.0.1; extra == 'world'",
    'ros-jazzy-rclpy[fastrtps]; extra == "ros"',
    'viser==1.1.*; python_version > "3" and extra == "viewer"',
    'websockets; extra == "viewer"',
]


class Metadata:
    """Metadata of a distribution in a folder, with the texts of some of its files."""

    def __init__(self, folder: Path, **files: str) -> None:
        self._folder, self._files = folder, files

    def locate_file(self, name):
        return self._folder / name

    def read_text(self, name):
        return self._files.get(name.partition(".")[0])


def section(text, title):
    blocks = dict(block.split("\n", 1) for block in text.strip().split("\n\n"))
    return dict(line.split(maxsplit=1) for line in blocks[title].splitlines())


def test_requirements_are_sorted_by_their_extras():
    assert parse_requirements(LINES, ["empty"]) == Requirements(
        ("numpy",),
        {
            "empty": (),
            "world": ("mujoco-core",),
            "ros": ("ros-jazzy-rclpy",),
            "viewer": ("viser", "websockets"),
        },
    )


def test_the_ros_distribution_is_read_from_the_name_of_its_wheel():
    assert parse_requirements(LINES).ros_wheels == {"jazzy": "ros-jazzy-rclpy"}


def test_an_extra_is_missing_if_one_of_its_distributions_is():
    versions = {"viser": "1.1.3", "websockets": None}
    assert extra_text(versions, versions.get) == "missing: websockets"
    versions["websockets"] = "16.0"
    assert extra_text(versions, versions.get) == "installed: viser 1.1.3, websockets 16.0"


def test_each_way_of_installation_is_told(tmp_path):
    editable = '{"dir_info": {"editable": true}, "url": "file:///home/me/omniman_ros"}'
    found = Metadata(tmp_path, WHEEL="", direct_url=editable)
    assert installation_text(found, {}) == "editable, from file:///home/me/omniman_ros"
    assert installation_text(Metadata(tmp_path, WHEEL=""), {}) == f"wheel, in {tmp_path}"
    assert installation_text(Metadata(tmp_path), {}) == f"by setuptools, in {tmp_path}"
    assert installation_text(None, {}) == "not installed: it runs from its source tree"


def test_the_commit_of_a_checkout_is_told_and_whether_files_were_changed(tmp_path, monkeypatch):
    package = tmp_path / "omniman_ros"
    assert commit_text(package) == "none: no git checkout"
    git = ("git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org")
    package.mkdir()
    (tmp_path / "file").write_text("as it was")
    for arguments in (["init", "-q"], ["add", "file"], ["commit", "-qm", "first"]):
        subprocess.run([*git, *arguments], check=True)
    hash_text = commit_text(package)
    assert len(hash_text) >= 7 and int(hash_text, 16)
    (tmp_path / "file").write_text("changed")
    assert commit_text(package) == f"{hash_text}-dirty"
    monkeypatch.setenv("PATH", "")
    assert commit_text(package) == "unknown: git does not run"


@pytest.mark.parametrize("is_symbolic", [False, True])
def test_colcon_is_known_by_its_marker(tmp_path, is_symbolic):
    prefix = tmp_path / "install" / "omniman_ros"
    marker = prefix / installation._COLCON_MARKER
    marker.parent.mkdir(parents=True)
    marker.touch()
    place = tmp_path / "build" if is_symbolic else prefix / "lib" / "python3.12" / "site-packages"
    environment = {"AMENT_PREFIX_PATH": f"{prefix}:/opt/ros/jazzy"} if is_symbolic else {}
    assert installation_text(Metadata(place), environment) == f"by colcon, in {prefix}"


def test_variables_that_are_not_set_are_told_with_what_ros_does():
    rows = dict(info.environment_rows({"ROS_DOMAIN_ID": "7", "CYCLONEDDS_URI": "", "HOME": "/"}))
    assert rows == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "not set: SUBNET"}


def test_it_tells_of_the_robot(capsys):
    assert main(["info", "--robot", "ig42"]) == 0
    robot = section(capsys.readouterr().out, "robot")
    assert robot["wheels"] == "4 Mecanum: front_left, front_right, rear_left, rear_right"
    assert robot["arm"].startswith("none")
    assert robot["file"].endswith("config/ig42.yaml")


BROKEN = {
    "no_yaml": "a: [1",
    "no_parameters": "a: 1",
    "unknown_name": "/**:\n  ros__parameters:\n    wheel: {radius: [0.1]}\n",
    "no_wheels": "/**:\n  ros__parameters:\n    held: {force: 1.0}\n",
    "binary": "\ud8ff\0",
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_robot_that_cannot_be_loaded_is_told_after_all_else(name, tmp_path, capsys):
    file = tmp_path / f"{name}.yaml"
    file.write_bytes(BROKEN[name].encode("utf-8", "surrogatepass"))
    assert main(["info", "--robot", str(file)]) == 1
    printed = capsys.readouterr().out
    assert section(printed, "robot").keys() == {"name", "file", "error"}
    assert section(printed, "machine")["CPUs"]


def test_a_robot_that_is_not_there_is_told_with_those_that_are(capsys):
    assert main(["info", "--robot", "nobody"]) == 1
    assert "ig42, omniman" in section(capsys.readouterr().out, "robot")["error"]


WITHOUT = """
import sys
for name in ("rclpy", "mujoco", "viser", "matplotlib", "rosbags", "casadi", "scipy", "can"):
    sys.modules[name] = None
from omniman_ros.cli.main import main
sys.exit(main(["info"]))
"""  #: Program that cannot import what may be missing


@pytest.mark.processes
def test_it_works_without_rclpy_and_extras():
    ended = subprocess.run([sys.executable, "-c", WITHOUT], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert section(ended.stdout, "ROS")["rclpy"] == "missing"
    assert section(ended.stdout, "robot")["wheels"].startswith("4 Mecanum")


def test_it_works_without_metadata(monkeypatch, capsys):
    monkeypatch.setattr(info, "own_distribution", lambda: None)
    assert main(["info"]) == 0
    printed = capsys.readouterr().out
    assert section(printed, "omniman_ros")["version"] == "unknown"
    assert section(printed, "libraries").keys() == set(info.LIBRARIES)


def test_a_middleware_that_cannot_be_loaded_is_told_why(monkeypatch):
    def fail(name):
        raise OSError("librmw_cyclonedds_cpp.so:\n cannot open")

    monkeypatch.setattr(info.importlib, "import_module", fail)
    rows = dict(info.ros_rows(Requirements((), {})))
    assert rows["middleware"] == "cannot be loaded: librmw_cyclonedds_cpp.so: cannot open"
