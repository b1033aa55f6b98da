"""The example for robot_localization against the odometry's frames and topics."""

import yaml

from omniman_ros.core.parameters import specs
from omniman_ros.nodes.platform_controller_parameters import PlatformControllerParameters
from test.config.documented import ROOT

FILE = ROOT / "config" / "robot_localization" / "map.yaml"
STATES = 15  #: Number of the filter's states: poses, rates, accelerations


def test_the_filter_publishes_where_odom_is_in_map_and_nothing_else():
    values = yaml.safe_load(FILE.read_text())["ekf_filter_node"]["ros__parameters"]
    defaults = {spec.name: spec.default for spec in specs(PlatformControllerParameters)}
    assert values["odom_frame"] == values["odom0"] == defaults["odom_frame"]
    assert values["base_link_frame"] == defaults["base_frame"]
    assert values["world_frame"] == values["map_frame"] == "map"
    assert values["two_d_mode"]
    used = {
        name.removesuffix("_config"): [k for k in range(STATES) if flags[k]]
        for name, flags in values.items()
        if name.endswith("_config") and len(flags) == STATES
    }
    # x, y, yaw are 0, 1, 5; their rates 6, 7, 11: the odometry's pose drifts, its twist does not.
    assert used == {"odom0": [6, 7, 11], "imu0": [11], "pose0": [0, 1, 5]}
