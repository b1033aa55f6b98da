"""Nav2's parameters against the robot's own file."""

import ast
import math

import numpy as np
import pytest
import rclpy
import yaml
from rclpy.node import Node

from omniman_ros.core.parameters import specs
from omniman_ros.nodes.platform_controller_parameters import PlatformControllerParameters
from omniman_ros.processes.nav2_setup import nav2_parameters
from omniman_ros.robots import robot_parameters

ROBOTS = ("omniman", "ig42")
COSTMAPS = ["local_costmap", "global_costmap"]


@pytest.fixture(scope="module", params=ROBOTS)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def nav2(name):
    return nav2_parameters(name)


@pytest.fixture(scope="module")
def robot(name):
    return robot_parameters(name)


def parameters(nav2, *names):
    tree = nav2
    for name in names:
        tree = tree[name]
    return tree["ros__parameters"]


def values_of(tree, wanted):
    """All values of a key, anywhere."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key == wanted:
                yield value
            yield from values_of(value, wanted)


def test_rcl_reads_it(nav2, tmp_path):
    # rcl's own parser knows less of YAML than others do: no aliases.
    file = tmp_path / "nav2.yaml"
    file.write_text(yaml.safe_dump(nav2))
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context)
    try:
        options = {"context": context, "start_parameter_services": False}
        node = Node(
            "local_costmap",
            namespace="local_costmap",
            automatically_declare_parameters_from_overrides=True,
            **options,
        )
        expected = parameters(nav2, "local_costmap", "local_costmap")["footprint"]
        assert node.get_parameter("footprint").value == expected
        node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def test_the_controller_is_omnidirectional_within_the_robots_limits(nav2, robot):
    mppi = parameters(nav2, "controller_server")["FollowPath"]
    assert mppi["motion_model"] == "Omni"
    assert mppi["vy_max"] > 0.0 and mppi["vx_min"] == -mppi["vx_max"]
    assert math.hypot(mppi["vx_max"], mppi["vy_max"]) == pytest.approx(
        robot["limits.linear_velocity"]
    )
    assert mppi["wz_max"] == robot["limits.angular_velocity"]
    assert math.hypot(mppi["ax_max"], mppi["ay_max"]) == pytest.approx(
        robot["limits.linear_acceleration"]
    )
    assert math.hypot(mppi["ax_min"], mppi["ay_min"]) == pytest.approx(
        robot["limits.linear_deceleration"]
    )
    assert mppi["ax_min"] < 0.0 and mppi["ay_min"] < 0.0
    assert mppi["az_max"] == robot["limits.angular_acceleration"]


def test_the_smoother_has_the_limits_of_the_controller(nav2, robot):
    mppi = parameters(nav2, "controller_server")["FollowPath"]
    smoother = parameters(nav2, "velocity_smoother")
    fastest = [mppi["vx_max"], mppi["vy_max"], mppi["wz_max"]]
    assert smoother["max_velocity"] == fastest
    assert smoother["min_velocity"] == [-v for v in fastest]
    assert smoother["max_accel"] == [mppi["ax_max"], mppi["ay_max"], mppi["az_max"]]
    angular = -robot["limits.angular_deceleration"]
    assert smoother["max_decel"] == [mppi["ax_min"], mppi["ay_min"], angular]
    behaviours = parameters(nav2, "behavior_server")
    assert behaviours["max_rotational_vel"] <= robot["limits.angular_velocity"]
    assert behaviours["rotational_acc_lim"] <= robot["limits.angular_acceleration"]


def test_a_base_that_goes_sideways_is_not_taken_to_stand(nav2):
    server = parameters(nav2, "controller_server")
    assert server["min_y_velocity_threshold"] == server["min_x_velocity_threshold"] < 0.01
    critics = server["FollowPath"]["critics"]
    assert not {"PreferForwardCritic", "PathAngleCritic"} & set(critics)
    assert set(critics) <= set(server["FollowPath"])


def test_the_horizon_runs_at_the_controllers_rate_and_stays_within_the_costmap(nav2):
    server = parameters(nav2, "controller_server")
    mppi = server["FollowPath"]
    assert mppi["model_dt"] == pytest.approx(1.0 / server["controller_frequency"])
    way = mppi["time_steps"] * mppi["model_dt"] * mppi["vx_max"]
    assert mppi["prune_distance"] >= way
    local = parameters(nav2, "local_costmap", "local_costmap")
    corner = math.hypot(*ast.literal_eval(local["footprint"])[0])
    assert min(local["width"], local["height"]) / 2 >= way + corner


def corners(parameters_of_costmap):
    return np.array(ast.literal_eval(parameters_of_costmap["footprint"]))


def test_the_footprint_is_the_robots_body_and_inflation_reaches_around_it(nav2, robot):
    half = (robot["body.length"] / 2, robot["body.width"] / 2)
    for costmap in (parameters(nav2, name, name) for name in COSTMAPS):
        assert sorted(map(tuple, corners(costmap))) == sorted(
            (sx * half[0], sy * half[1]) for sx in (1, -1) for sy in (1, -1)
        )
        assert costmap["inflation_layer"]["inflation_radius"] > math.hypot(*half)
        assert "filters" not in costmap


def test_an_arm_that_sticks_out_is_in_the_footprint():
    stretched = {"footprint.posture": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)}
    costmap = parameters(nav2_parameters("omniman", values=stretched), *2 * COSTMAPS[:1])
    # The UR5 reaches 0.85 m to its wrist, from its base 0.2 m before the middle.
    assert 1.05 < corners(costmap)[:, 0].max() < 1.25
    assert costmap["inflation_layer"]["inflation_radius"] > corners(costmap)[:, 0].max()


def test_zones_to_keep_out_of_are_layers_of_both_costmaps_in_the_robots_namespace():
    nav2 = nav2_parameters("omniman", namespace="robot1", keeps_out=True)
    assert list(nav2) == ["robot1"]
    nav2 = nav2["robot1"]
    info = parameters(nav2, "costmap_filter_info_server")
    mask = parameters(nav2, "filter_mask_server")
    assert info["mask_topic"] == f"/robot1/{mask['topic_name']}"
    for costmap in (parameters(nav2, name, name) for name in COSTMAPS):
        (layer,) = costmap["filters"]
        assert costmap[layer]["plugin"] == "nav2_costmap_2d::KeepoutFilter"
        assert costmap[layer]["filter_info_topic"] == f"/robot1/{info['filter_info_topic']}"
        assert costmap["obstacle_layer"]["scan"]["topic"] == "/robot1/scan"


def test_frames_and_topics_are_ours(nav2):
    defaults = {spec.name: spec.default for spec in specs(PlatformControllerParameters)}
    odom, base = defaults["odom_frame"], defaults["base_frame"]
    for key in ("robot_base_frame", "base_frame_id"):
        assert set(values_of(nav2, key)) == {base}
    for key in ("odom_frame_id", "local_frame", "odom_topic"):
        assert set(values_of(nav2, key)) == {odom}
    assert parameters(nav2, "nav2_collision_monitor")["cmd_vel_out_topic"] == "cmd_vel"


def test_all_that_drives_sends_the_twist_that_the_platform_takes(nav2):
    assert PlatformControllerParameters.__dataclass_fields__["cmd_vel_stamped"].default is False
    drivers = {
        "bt_navigator",
        "controller_server",
        "behavior_server",
        "velocity_smoother",
        "nav2_collision_monitor",
    }
    for name in drivers:
        assert parameters(nav2, name)["enable_stamped_cmd_vel"] is False
