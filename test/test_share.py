import sys
from pathlib import Path
from types import ModuleType

import pytest

from omniman_ros import share
from omniman_ros.share import share_path

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Puts the module where an installation would have it, with no prefix and no index around."""

    def put(module: str) -> Path:
        monkeypatch.setattr(share, "__file__", str(tmp_path / module))
        return tmp_path

    monkeypatch.setattr(sys, "prefix", str(tmp_path / "no prefix"))
    monkeypatch.setitem(sys.modules, "ament_index_python", None)
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", None)
    return put


def make(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("")
    return path


def test_finds_the_files_of_this_repository():
    assert share_path("config", "omniman.yaml").is_file()
    assert share_path("launch", "platform.launch.py").is_file()
    assert share_path("config").is_dir()


def test_source_tree_keeps_every_folder_below_config(place):
    root = place("omniman_ros/share.py")
    make(root / "package.xml")
    robot = make(root / "config/robot.yaml")
    model = make(root / "config/urdf/robot.urdf")
    assert share_path("config", "robot.yaml") == robot
    assert share_path("urdf", "robot.urdf") == model


def test_source_tree_comes_before_the_prefix(place):
    root = place("lib/python3/src/omniman_ros/share.py")
    make(root / "lib/python3/src/package.xml")
    source = make(root / "lib/python3/src/config/robot.yaml")
    make(root / "share/omniman_ros/config/robot.yaml")
    assert share_path("config", "robot.yaml") == source


@pytest.mark.parametrize(
    "packages", ["lib/python3.12/site-packages", "local/lib/python3.12/dist-packages", "target"]
)
def test_prefix_is_found_from_the_module(place, packages):
    root = place(f"{packages}/omniman_ros/share.py")
    prefix = root / packages.partition("/lib/")[0].removeprefix("lib/python3.12/site-packages")
    robot = make(prefix / "share/omniman_ros/config/robot.yaml")
    assert share_path("config", "robot.yaml") == robot


def test_prefix_of_the_interpreter_is_looked_in(place, monkeypatch):
    root = place("elsewhere/omniman_ros/share.py")
    monkeypatch.setattr(sys, "prefix", str(root / "venv"))
    robot = make(root / "venv/share/omniman_ros/config/robot.yaml")
    assert share_path("config", "robot.yaml") == robot


def ament_index(monkeypatch, answer):
    packages = ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = answer
    monkeypatch.setitem(sys.modules, "ament_index_python", ModuleType("ament_index_python"))
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", packages)


def test_ament_index_comes_last(place, monkeypatch):
    root = place("elsewhere/omniman_ros/share.py")
    robot = make(root / "opt/share/omniman_ros/config/robot.yaml")
    ament_index(monkeypatch, lambda name: str(root / "opt/share" / name))
    assert share_path("config", "robot.yaml") == robot


@pytest.mark.parametrize("error", [OSError("AMENT_PREFIX_PATH"), KeyError("omniman_ros")])
def test_an_ament_index_without_the_package_is_passed_over(place, monkeypatch, error):
    def answer(name):
        raise error

    place("elsewhere/omniman_ros/share.py")
    ament_index(monkeypatch, answer)
    with pytest.raises(FileNotFoundError):
        share_path("config", "robot.yaml")


def test_what_is_nowhere_is_an_error_that_lists_the_places(place):
    root = place("lib/python3.12/site-packages/omniman_ros/share.py")
    with pytest.raises(FileNotFoundError) as caught:
        share_path("config", "nothing.yaml")
    message = str(caught.value)
    assert "config/nothing.yaml" in message
    assert str(root / "share/omniman_ros/config/nothing.yaml") in message
    assert str(root / "no prefix/share/omniman_ros/config/nothing.yaml") in message
