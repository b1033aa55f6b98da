import re

import pytest

from omniman_ros.cli.main import main, make_parser
from omniman_ros.console.errors import CommandError
from omniman_ros.processes import drive_options
from omniman_ros.processes.drive_options import (
    FIRST_PORT,
    MULTICAST_GROUP,
    find_installation_file,
    private_bus_arguments,
)
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes

BRIDGE, DRIVES = "can_bridge", "simulated_can_drives"
ALWAYS_STARTED = {
    "platform_controller",
    "path_interpolator",
    "mpc_planner",
    "joint_states_merger",
    "viewer",
}


def specs_by_name(**options):
    return {spec.name: spec for spec in robot_processes(RobotSetup(**options))}


def arguments(node, **options):
    return " ".join(specs_by_name(**options)[node].command)


@pytest.mark.parametrize("name", ["cia402", "vesc", "odrive"])
def test_a_name_refers_to_an_installation_of_the_package(name):
    assert find_installation_file(name).endswith(f"config/can/{name}.yaml")


def test_a_path_of_an_installation_is_made_absolute(tmp_path, monkeypatch):
    (tmp_path / "lab.yaml").write_text("")
    monkeypatch.chdir(tmp_path)
    assert find_installation_file("lab.yaml") == str(tmp_path / "lab.yaml")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find_installation_file("~/lab.yaml") == str(tmp_path / "lab.yaml")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lab", "no installation 'lab'; there are cia402, odrive, vesc"),
        ("lab.yaml", "no installation 'lab.yaml'"),
        ("", "no installation ''"),
    ],
)
def test_an_unknown_installation_is_named_in_the_error(name, message):
    with pytest.raises(CommandError, match=message) as error:
        find_installation_file(name)
    assert error.value.code == 2


@pytest.mark.parametrize(
    ("drive", "started"),
    [("simulated", {"simulated_drive"}), ("can", {BRIDGE, DRIVES}), ("real", {BRIDGE})],
)
def test_each_kind_of_drive_starts_its_own_nodes(drive, started):
    assert set(specs_by_name(drive=drive, arm="none")) - ALWAYS_STARTED == started


def test_the_controller_is_stopped_before_the_bridge_and_the_bridge_before_the_drives():
    started = specs_by_name(drive="can")
    stages = [started[name].stage for name in ("platform_controller", BRIDGE, DRIVES)]
    assert stages == sorted(set(stages))


def test_all_nodes_on_the_bus_get_the_same_installation(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    for node in (BRIDGE, DRIVES):
        text = arguments(node, drive="can", installation="odrive")
        assert f"--params-file {find_installation_file('odrive')}" in text
        assert "-p can.interface:=udp_multicast" in text
        assert f"-p can.channel:='{MULTICAST_GROUP}' -p can.port:={FIRST_PORT + 7}" in text
    assert "--params-file" not in arguments("platform_controller", drive="can")


def test_a_real_bus_is_taken_from_the_file_of_the_installation():
    text = arguments(BRIDGE, drive="real", installation="vesc")
    assert f"--params-file {find_installation_file('vesc')}" in text
    assert "can.interface" not in text and "can.port" not in text


def test_parameters_of_the_user_take_precedence_over_the_installation(tmp_path):
    file = tmp_path / "more.yaml"
    file.write_text("")
    text = arguments(BRIDGE, drive="can", params=["can.rate:=50.0"], params_file=str(file))
    ours, bus = text.index("cia402.yaml"), text.index("can.port")
    assert ours < bus < text.index(str(file)) < text.index("can.rate:=50.0")


def test_robots_in_different_domains_have_different_buses(monkeypatch):
    ports = set()
    for domain in ("0", "1", "232"):
        monkeypatch.setenv("ROS_DOMAIN_ID", domain)
        ports.add(private_bus_arguments()[-1])
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert private_bus_arguments()[-1] == f"can.port:={FIRST_PORT}"
    assert len(ports) == 3


def test_robots_in_different_namespaces_have_different_buses(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    names = ("", "robot1", "robot2", "left", "right")
    ports = {name: int(private_bus_arguments(name)[-1].rpartition("=")[2]) for name in names}
    assert len(set(ports.values())) == len(names)
    assert max(ports.values()) < 65536 - 232
    assert private_bus_arguments("/robot1/") == private_bus_arguments("robot1")


def test_real_drives_are_refused_in_simulated_time():
    with pytest.raises(CommandError, match="--sim-time: drives 'real'"):
        robot_processes(RobotSetup(drive="real", sim_time=True))


def test_in_simulated_time_bridge_and_drives_meet_at_a_port_with_the_timeouts_of_real_drives():
    specs = robot_processes(RobotSetup(drive="can", sim_time=True))
    bridge, drives = (
        " ".join(spec.command)
        for name in ("can_bridge", "simulated_can_drives")
        for spec in specs
        if spec.name == name
    )
    (port,) = re.findall(r"-p simulated_bus_port:=(\d+)", bridge)
    assert f"-p bus_port:={port}" in drives
    assert "use_sim_time:=true" in bridge and "publish_clock:=true" in drives
    assert "use_sim_time" not in drives
    for words in (bridge, drives):
        assert "udp_multicast" not in words and "missed_periods" not in words


def test_up_and_demo_have_the_same_options_but_the_demo_refuses_real_drives(capsys):
    parse = make_parser().parse_args
    for command in ("up", "demo"):
        assert (parse([command]).drive, parse([command]).installation) == ("simulated", "cia402")
        given = parse([command, "--drive", "can", "--installation", "vesc"])
        assert (given.drive, given.installation) == ("can", "vesc")
    assert parse(["up", "--drive", "real"]).drive == "real"
    for wrong in (["demo", "--drive", "real"], ["up", "--drive", "none"]):
        with pytest.raises(SystemExit) as end:
            parse(wrong)
        assert end.value.code == 2
    assert set(drive_options.DRIVES) == {"simulated", "can", "real"}


@pytest.mark.processes
@pytest.mark.parametrize("command", ["up", "demo"])
def test_an_unknown_installation_ends_the_command_with_code_2(command, capsys, own_domain):
    assert main([command, "--drive", "can", "--installation", "lab"]) == 2
    assert "no installation 'lab'" in capsys.readouterr().err
