"""A node that has ended, seen by its peers on `stop_state`."""

import pytest

from omniman_ros.core.stop import StopState
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import STOP_STATE, publisher_nodes
from test.nodes.harness import World


@pytest.mark.parametrize(
    ("cause", "state", "reason"),
    [
        ("", StopState.RUNNING, ""),
        ("bus off", StopState.STOPPED, "peer /platform_controller vanished while it was stopped"),
    ],
    ids=["in order", "stopped by a fault"],
)
def test_only_a_node_that_was_stopped_before_its_end_leaves_a_stop(cause, state, reason):
    with World(PlatformControllerNode, SimulatedDriveNode) as world:
        controller, drive = world.nodes
        world.run(0.1)
        if cause:
            controller.core.latch.stop(cause)
        controller.begin_shutdown("SIGINT")
        world.run_until(
            lambda: drive.latch.status.state is StopState.HOLDING, 1.0, "the hold of the drive"
        )
        world.nodes.remove(controller)
        world.executor.remove_node(controller)
        controller.destroy_node()
        world._await(
            lambda: "/platform_controller" not in publisher_nodes(drive, STOP_STATE),
            "the end of the controller",
        )
        world.run(1.1)
        assert (drive.latch.status.state, drive.latch.status.reason) == (state, reason)
