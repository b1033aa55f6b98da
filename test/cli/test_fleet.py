import os
import sys

import pytest

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import Setup, resolved, tasks
from omniman_ros.viewer import availability
from test import robots


def by_name(setup):
    return {task.name: task for task in tasks(setup)}


def arguments(setup, node):
    return " ".join(by_name(setup)[node].command)


def test_the_controller_is_stopped_before_the_drive():
    started = by_name(Setup())
    assert started["platform_controller"].stage < started["simulated_drive"].stage


def test_nodes_run_on_this_python_and_end_with_this_process():
    for task in tasks(Setup()):
        assert task.command[:4] == (
            sys.executable, "-m", "omniman_ros.cli.node", str(os.getpid())
        )  # fmt: skip


def test_only_some_nodes_can_be_started():
    assert set(by_name(Setup(only=["simulated_drive"]))) == {"simulated_drive"}


def test_the_viewer_is_left_out_where_its_library_is_not(monkeypatch):
    monkeypatch.setattr(availability, "find_spec", lambda name: None)
    assert "viewer" not in by_name(Setup())
    assert set(by_name(Setup(only=["viewer"]))) == {"viewer"}, "it says itself what is missing"
    monkeypatch.setattr(availability, "find_spec", lambda name: object())
    assert "viewer" in by_name(Setup())


def test_the_drive_makes_the_simulated_time_that_the_others_follow():
    setup = Setup(sim_time=True)
    assert "-p publish_clock:=true" in arguments(setup, "simulated_drive")
    assert "use_sim_time" not in arguments(setup, "simulated_drive")
    assert "-p use_sim_time:=true" in arguments(setup, "platform_controller")


@pytest.mark.parametrize("namespace", ["robot1", "/robot1", "/robot1/"])
def test_namespace_parameters_and_file_reach_every_node(namespace, tmp_path):
    file = tmp_path / "more.yaml"
    file.write_text("")
    setup = Setup(
        robot="ig42", namespace=namespace, params=["drive.mode:=torque"], params_file=str(file)
    )
    for node in by_name(setup):
        text = arguments(setup, node)
        assert "-p robot:=ig42" in text
        assert "-r __ns:=/robot1 -r /tf:=tf" in text
        assert "-p drive.mode:=torque" in text
        assert f"--params-file {file}" in text


def test_a_robot_is_a_name_or_the_path_of_a_file(monkeypatch):
    assert resolved("ig42") == "ig42"
    path = robots.path("omni3")
    monkeypatch.chdir(os.path.dirname(path))
    assert resolved("omni3.yaml") == path
    with pytest.raises(CommandError, match="expected one of"):
        resolved("nobody")
