"""Who may import what: the page knows no ROS, and what it knows needs no browser."""

from pathlib import Path

import pytest

import omniman_ros.viewer
from test.core.test_purity import below, imports

PACKAGE = Path(omniman_ros.viewer.__file__).parent
DRAWN = {
    "page", "panel", "buttons", "obstacle_panel", "tuning_panel", "plots", "guard",
    "scene", "robot_scene", "floor_scene", "things", "grasp",
}  # fmt: skip
"""Modules that need viser and what it brings."""
ALL = sorted(PACKAGE.glob("*.py"))


def test_there_are_files_to_check():
    assert {path.stem for path in ALL} > DRAWN


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_the_page_knows_no_ros(path):
    for name in imports(path):
        assert not below(name, "rclpy", "omniman_ros.nodes", "omniman_ros.cli"), name
        assert not name.split(".")[0].endswith(("_msgs", "_srvs")), name


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_what_is_not_drawn_needs_no_viser(path):
    if path.stem not in DRAWN:
        for name in imports(path):
            assert not below(name, "viser", "websockets"), name
