"""The Nav2 example against the robot's own file: no speed, no length is written twice unequal."""

import ast
import math

import pytest
import rclpy
import yaml
from rclpy.node import Node

from omniman_ros.core.parameters import specs
from omniman_ros.nodes.platform_controller_parameters import PlatformControllerParameters
from omniman_ros.robots import load_robot
from test.config.documented import ROOT

FILE = ROOT / "config" / "nav2" / "omniman.yaml"


@pytest.fixture(scope="module")
def nav2():
    return yaml.safe_load(FILE.read_text())


@pytest.fixture(scope="module")
def robot():
    return load_robot("omniman")


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


def test_rcl_reads_it(nav2):
    # rcl's own parser knows less of YAML than others do: no aliases.
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "--params-file", str(FILE)], context=context)
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


def test_the_footprint_is_the_robots_body_and_inflation_reaches_around_it(nav2, robot):
    half = (robot["body.length"] / 2, robot["body.width"] / 2)
    costmaps = [parameters(nav2, name, name) for name in ("local_costmap", "global_costmap")]
    for costmap in costmaps:
        corners = ast.literal_eval(costmap["footprint"])
        assert sorted(map(tuple, corners)) == sorted(
            (sx * half[0], sy * half[1]) for sx in (1, -1) for sy in (1, -1)
        )
        assert costmap["inflation_layer"]["inflation_radius"] > math.hypot(*half)


def test_frames_and_topics_are_ours(nav2):
    defaults = {spec.name: spec.default for spec in specs(PlatformControllerParameters)}
    odom, base = defaults["odom_frame"], defaults["base_frame"]
    for key in ("robot_base_frame", "base_frame_id", "base_frame"):
        assert set(values_of(nav2, key)) == {base}
    for key in ("odom_frame_id", "local_frame", "fixed_frame", "odom_topic"):
        assert set(values_of(nav2, key)) == {odom}
    assert parameters(nav2, "collision_monitor")["cmd_vel_out_topic"] == "cmd_vel"


def test_all_that_drives_sends_the_twist_that_the_platform_takes(nav2):
    assert PlatformControllerParameters.__dataclass_fields__["cmd_vel_stamped"].default is False
    drivers = {
        "bt_navigator",
        "controller_server",
        "behavior_server",
        "velocity_smoother",
        "collision_monitor",
        "docking_server",
    }
    for name in drivers:
        assert parameters(nav2, name)["enable_stamped_cmd_vel"] is False
