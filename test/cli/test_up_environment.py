import pytest

from omniman_ros.cli.up import node_environment
from omniman_ros.processes.robot_setup import RobotSetup


@pytest.mark.parametrize(
    ("sim_time", "given", "transports"),
    [
        (False, {}, "UDPv4"),
        (True, {}, None),
        (False, {"FASTDDS_BUILTIN_TRANSPORTS": "SHM"}, "SHM"),
    ],
)
def test_nodes_on_real_time_have_no_shared_memory_unless_the_user_chooses_so(
    sim_time, given, transports
):
    environment = node_environment({"HOME": "/", **given}, RobotSetup(sim_time=sim_time))
    assert environment.get("FASTDDS_BUILTIN_TRANSPORTS") == transports
    assert environment["HOME"] == "/"
