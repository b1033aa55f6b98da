"""The files of installations of drives, against the parameters that they set."""

import pytest
import yaml

from omniman_ros.core.can_parameters import NODE_IDS, CanParameters
from omniman_ros.core.parameters import build, specs
from omniman_ros.core.platform import Platform
from omniman_ros.robots import robot_parameters
from omniman_ros.share import share_path

FILES = sorted(share_path("config", "can").glob("*.yaml"))
NAMES = {spec.name for spec in specs(CanParameters, "can.")}


def test_each_protocol_has_a_file():
    protocols = {robot_parameters(str(path))["can.protocol"] for path in FILES}
    assert protocols == set(NODE_IDS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_is_for_every_node_and_sets_only_known_parameters(path):
    assert list(yaml.safe_load(path.read_text())) == ["/**"]
    assert set(robot_parameters(str(path))) <= NAMES


@pytest.mark.parametrize("robot", ["omniman", "ig42"])
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_file_fits_every_robot_of_the_package(path, robot):
    parameters = build(CanParameters, robot_parameters(str(path)), "can.")
    parameters.check(build(Platform, robot_parameters(robot)))
    assert parameters.interface == "socketcan"
