"""Which arm is started, with what."""

import socket

import pytest
import yaml

from omniman_ros.arm.parameters import UrParameters
from omniman_ros.cli import arm
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import Setup, tasks
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import build, flatten_mapping
from omniman_ros.share import share_path

ARM = {"arm_streamer", "simulated_ur"}


def commands(**setup):
    return {task.name: " ".join(task.command) for task in tasks(Setup(**setup))}


def test_a_simulated_robot_has_a_simulated_arm():
    started = commands()
    assert set(started) >= ARM
    for node in (*ARM, "path_interpolator"):
        assert "-p ports.rtde:=" in started[node]
    assert "ports.rtde" not in started["platform_controller"]


@pytest.mark.parametrize("setup", [{"drive": "real"}, {"sim_time": True}, {"arm": "none"}])
def test_where_an_arm_does_not_fit_there_is_none(setup):
    assert not set(commands(**setup)) & ARM


def test_the_simulated_controller_outlives_its_client_and_that_those_who_lead_it():
    stages = {task.name: task.stage for task in tasks(Setup())}
    assert stages["path_interpolator"] < stages["arm_streamer"] < stages["simulated_ur"]


def test_simulated_time_with_an_arm_is_refused():
    with pytest.raises(CommandError, match="--sim-time: the arm 'ur' runs on real time"):
        commands(sim_time=True, arm="ur")


def test_a_real_arm_and_who_plans_for_it_have_the_controllers_file(tmp_path):
    file = tmp_path / "lab.yaml"
    file.write_text("")
    started = commands(arm="ur", controller=str(file))
    assert "simulated_ur" not in started
    for node in ("arm_streamer", "path_interpolator"):
        assert f"--params-file {file}" in started[node]
    assert "/config/ur/ur5.yaml" in commands(arm="ur")["arm_streamer"]
    with pytest.raises(CommandError, match="no controller 'ur99'; there are ur5"):
        commands(arm="ur", controller="ur99")


def test_where_the_usual_ports_are_taken_others_are_used():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert not arm._are_free([port])
    assert arm._are_free([port])
    numbers = arm._free(5)
    assert len(set(numbers)) == 5


def test_client_and_controller_are_told_the_same_ports():
    words = dict(word.split(":=") for word in arm.private_controller() if word != "-p")
    assert words["ports.rtde"] == words["ur.rtde_port"]
    assert words["ports.secondary"] == words["ur.script_port"]
    assert words["ports.dashboard"] == words["ur.dashboard_port"]


def test_the_controllers_file_has_parameters_that_are_taken():
    tree = yaml.safe_load(share_path("config", "ur", "ur5.yaml").read_text())
    values = flatten_mapping(tree["/**"]["ros__parameters"])
    assert build(UrParameters, values, "ur.").host == "192.168.56.101"
    build(ArmParameters, values, "arm.")
    known = {name for name in values if name.startswith(("ur.", "arm."))}
    assert known == set(values)
    fields = set(UrParameters.__dataclass_fields__) | set(ArmParameters.__dataclass_fields__)
    assert {name.partition(".")[2] for name in values} <= fields
