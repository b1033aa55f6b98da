import os
import re
import sys

import pytest

from omniman_ros import extras
from omniman_ros.console.errors import CommandError
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot, robot_processes
from omniman_ros.share import share_path
from test import robots


def specs_by_name(setup):
    return {spec.name: spec for spec in robot_processes(setup)}


def arguments(setup, node):
    return " ".join(specs_by_name(setup)[node].command)


def test_the_controller_is_stopped_before_the_drive():
    started = specs_by_name(RobotSetup())
    assert started["platform_controller"].stage < started["simulated_drive"].stage


def test_nodes_run_in_this_python_and_end_with_this_process():
    for spec in robot_processes(RobotSetup()):
        assert spec.command[:4] == (
            sys.executable,
            "-m",
            "omniman_ros.processes.run_node",
            str(os.getpid()),
        )


def test_only_the_nodes_asked_for_are_started():
    assert set(specs_by_name(RobotSetup(only=["simulated_drive"]))) == {"simulated_drive"}


def test_the_viewer_is_left_out_if_its_library_is_not_installed(monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert "viewer" not in specs_by_name(RobotSetup())
    assert set(specs_by_name(RobotSetup(only=["viewer"]))) == {"viewer"}, (
        "the viewer itself says what is missing"
    )
    monkeypatch.setattr(extras, "find_spec", lambda name: object())
    assert "viewer" in specs_by_name(RobotSetup())


def test_the_controller_needs_the_collision_monitor_where_there_is_one():
    used = "-p collision_monitor.use:=true"
    assert used in arguments(RobotSetup(collision_monitor=True), "platform_controller")
    nodes = ["platform_controller", "collision_monitor"]
    assert used in arguments(RobotSetup(only=nodes), "platform_controller")
    for setup in (RobotSetup(), RobotSetup(only=nodes[:1], collision_monitor=True)):
        assert "collision_monitor" not in specs_by_name(setup)
        assert used not in arguments(setup, "platform_controller")


def test_who_plans_and_limits_awaits_the_obstacles_of_the_tracker_where_it_is_started():
    required = "-p obstacles.required:=true"
    for name in ("mpc_planner", "whole_body_planner", "collision_monitor"):
        assert required in arguments(RobotSetup(only=[name, "obstacle_tracker"]), name)
        assert required not in arguments(RobotSetup(only=[name]), name)


def test_the_obstacle_tracker_is_started_on_request(with_engine):
    assert "obstacle_tracker" not in specs_by_name(RobotSetup())
    assert "obstacle_tracker" in specs_by_name(RobotSetup(obstacle_tracker=True))
    by_parameters = "-p scanners_by_tf:=false"
    in_world = RobotSetup(obstacle_tracker=True, world="hall")
    assert by_parameters in arguments(in_world, "obstacle_tracker")
    assert by_parameters in arguments(in_world, "viewer")
    outside = RobotSetup(only=["obstacle_tracker"])
    assert by_parameters not in arguments(outside, "obstacle_tracker")


def test_the_whole_body_planner_takes_the_tool_paths_on_request():
    left_out = "-p takes_tool_paths:=false"
    assert "whole_body_planner" not in specs_by_name(RobotSetup())
    assert left_out not in arguments(RobotSetup(), "path_interpolator")
    setup = RobotSetup(whole_body_planner=True, collision_monitor=True)
    assert "-p collision_monitor.use:=true" in arguments(setup, "whole_body_planner")
    assert left_out in arguments(setup, "path_interpolator")
    both = RobotSetup(only=["whole_body_planner", "path_interpolator"])
    assert left_out in arguments(both, "path_interpolator")


def test_the_drive_publishes_the_clock_that_the_other_nodes_follow():
    setup = RobotSetup(sim_time=True)
    assert "-p publish_clock:=true" in arguments(setup, "simulated_drive")
    assert "use_sim_time" not in arguments(setup, "simulated_drive")
    assert "-p use_sim_time:=true" in arguments(setup, "platform_controller")


@pytest.fixture
def with_engine(monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: object())


def test_a_world_replaces_the_simulated_drive(with_engine):
    setup = RobotSetup(world="corridor", sim_time=True)
    assert "simulated_drive" not in specs_by_name(setup)
    text = arguments(setup, "simulated_world")
    assert f"-p scene:={share_path('config', 'worlds', 'corridor.yaml')}" in text
    assert "-p publish_clock:=true" in text
    assert "scene:=" not in arguments(setup, "platform_controller")
    assert "simulated_world" not in specs_by_name(RobotSetup())


def test_the_arm_of_the_simulated_controller_is_in_the_world(with_engine):
    texts = {
        spec.name: " ".join(spec.command) for spec in robot_processes(RobotSetup(world="empty"))
    }
    (port,) = re.findall(r"simulated_arm\.world_port:=(\d+)", texts["simulated_ur"])
    assert f"-p arm_port:={port}" in texts["simulated_world"]
    assert "-p ur.servo_lag:=0.062" in texts["arm_streamer"], "the link takes time"
    assert not any("arm_port" in text for name, text in texts.items() if name != "simulated_world")


@pytest.mark.parametrize(
    "setup",
    [
        RobotSetup(world="empty", arm="none"),
        RobotSetup(world="empty", robot="ig42"),
        RobotSetup(world="empty", only=["simulated_world"]),
        RobotSetup(),
    ],
)
def test_without_an_arm_or_a_world_nothing_is_linked(with_engine, setup):
    texts = [" ".join(spec.command) for spec in robot_processes(setup)]
    assert not any("world_port" in text or "arm_port" in text for text in texts)


def test_the_urdf_has_no_arm_where_nothing_moves_it():
    hidden = "-p describe_arm:=false"
    assert hidden in arguments(RobotSetup(arm="none"), "joint_states_merger")
    assert hidden not in arguments(RobotSetup(), "joint_states_merger")
    only = RobotSetup(arm="none", only=["joint_states_merger"])
    assert hidden not in arguments(only, "joint_states_merger"), "the arm may be elsewhere"


def test_a_scene_of_the_user_is_found_from_any_folder(with_engine, tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text("")
    monkeypatch.chdir(tmp_path)
    text = arguments(RobotSetup(world="mine.yaml"), "simulated_world")
    assert f"-p scene:={tmp_path / 'mine.yaml'}" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"world": "nowhere"}, "--world: must be one of .*workshop"),
        ({"world": "empty", "drive": "can"}, "--world: drives 'can' are not in a world"),
        ({"world": "empty", "only": ["viewer"]}, "simulated_world is not among"),
    ],
)
def test_a_world_that_cannot_be_used_is_refused(with_engine, options, message):
    with pytest.raises(CommandError, match=message) as error:
        robot_processes(RobotSetup(**options))
    assert error.value.code == 2


def test_a_world_without_the_engine_is_refused_with_what_to_install(monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(CommandError, match="pip install"):
        robot_processes(RobotSetup(world="empty"))


@pytest.mark.parametrize("namespace", ["robot1", "/robot1", "/robot1/"])
def test_namespace_parameters_and_parameter_file_reach_every_node(namespace, tmp_path):
    file = tmp_path / "more.yaml"
    file.write_text("")
    setup = RobotSetup(
        robot="ig42", namespace=namespace, params=["drive.mode:=torque"], params_file=str(file)
    )
    for node in specs_by_name(setup):
        text = arguments(setup, node)
        assert "-p robot:=ig42" in text
        assert "-r __ns:=/robot1 -r /tf:=tf" in text
        assert "-p drive.mode:=torque" in text
        assert f"--params-file {file}" in text


def test_a_robot_is_a_name_or_the_path_of_a_file(monkeypatch):
    assert resolve_robot("ig42") == "ig42"
    path = robots.path("omni3")
    monkeypatch.chdir(os.path.dirname(path))
    assert resolve_robot("omni3.yaml") == path
    with pytest.raises(CommandError, match="must be one of"):
        resolve_robot("nobody")
