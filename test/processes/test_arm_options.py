"""Options of the arm: which nodes are started, and with which parameters."""

import pytest
import yaml

from omniman_ros.console.errors import CommandError
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import build, flatten_mapping
from omniman_ros.processes import arm_options
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes
from omniman_ros.share import share_path
from omniman_ros.ur.parameters import UrParameters

ARM = {"arm_streamer", "simulated_ur"}


def commands(**setup):
    return {spec.name: " ".join(spec.command) for spec in robot_processes(RobotSetup(**setup))}


def test_a_simulated_robot_has_a_simulated_arm():
    started = commands()
    assert set(started) >= ARM
    for node in (*ARM, "path_interpolator"):
        assert "-p ports.rtde:=" in started[node]
    assert "ports.rtde" not in started["platform_controller"]


@pytest.mark.parametrize("setup", [{"drive": "real"}, {"arm": "none"}])
def test_there_is_no_arm_with_real_drives_unless_asked_for(setup):
    assert not set(commands(**setup)) & ARM


def test_the_simulated_arm_shares_the_simulated_time_of_the_robot():
    started = commands(sim_time=True)
    assert "-p use_sim_time:=true" in started["simulated_ur"]
    assert "-p use_sim_time:=true -p simulated_controller:=true" in started["arm_streamer"]
    assert "simulated_controller" not in commands()["arm_streamer"]


def test_the_simulated_controller_outlives_its_client_which_outlives_the_interpolator():
    stages = {spec.name: spec.stage for spec in robot_processes(RobotSetup())}
    assert stages["path_interpolator"] < stages["arm_streamer"] < stages["simulated_ur"]


def test_simulated_time_with_an_arm_is_refused():
    with pytest.raises(CommandError, match="--sim-time: the arm 'ur' runs on real time"):
        commands(sim_time=True, arm="ur")


def test_the_nodes_of_a_real_arm_and_its_interpolator_get_the_controllers_file(tmp_path):
    file = tmp_path / "lab.yaml"
    file.write_text("")
    started = commands(arm="ur", controller=str(file))
    assert "simulated_ur" not in started
    for node in ("arm_streamer", "path_interpolator"):
        assert f"--params-file {file}" in started[node]
    assert "/config/ur/ur5.yaml" in commands(arm="ur")["arm_streamer"]
    with pytest.raises(CommandError, match="no controller 'ur99'; there are ur5"):
        commands(arm="ur", controller="ur99")


def test_client_and_controller_get_the_same_ports():
    words = dict(
        word.split(":=") for word in arm_options.private_controller_arguments() if word != "-p"
    )
    assert words["ports.rtde"] == words["ur.rtde_port"]
    assert words["ports.secondary"] == words["ur.script_port"]
    assert words["ports.dashboard"] == words["ur.dashboard_port"]


def test_the_controllers_file_has_only_known_parameters():
    tree = yaml.safe_load(share_path("config", "ur", "ur5.yaml").read_text())
    values = flatten_mapping(tree["/**"]["ros__parameters"])
    assert build(UrParameters, values, "ur.").host == "192.168.56.101"
    build(ArmParameters, values, "arm.")
    known = {name for name in values if name.startswith(("ur.", "arm."))}
    assert known == set(values)
    fields = set(UrParameters.__dataclass_fields__) | set(ArmParameters.__dataclass_fields__)
    assert {name.partition(".")[2] for name in values} <= fields
