from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.lab.bench.whole_body_obstacles import figures_of
from omniman_ros.lab.measurement import columns_at
from omniman_ros.lab.studies.avoidance_scenes import POST, START, AvoidanceScene, SceneGenerator
from omniman_ros.lab.studies.body_drivers import AvoidingBody, FixedPosture
from omniman_ros.lab.studies.body_judge import judged
from omniman_ros.lab.studies.body_loop import BodyLoop
from omniman_ros.planning.whole_body.parameters import OrientationFreedom
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters

pytest.importorskip("mujoco")

GENERATOR = SceneGenerator("omniman")


def scene_with_post(x, y):
    """The tool moves 0.6 m ahead; a post stands at a position."""
    poses = GENERATOR.model.forward(START)[None].repeat(12, axis=0)
    poses[:, 0, 3] += np.linspace(0.05, 0.6, 12)
    fixed = GENERATOR.planner.plan(poses, START).curve
    return AvoidanceScene(poses, fixed, (POST,), np.array([[x, y]]), np.zeros((1, 2)))


def driven(scene, driver):
    robot = dict(robot_parameters(resolve_robot("omniman")))
    record = BodyLoop(robot, "ideal", scene, START[3:], 1).run(driver, 12.0)
    return figures_of(judged(GENERATOR, scene, record), scene.fixed.duration)


def test_the_body_evades_a_post_that_the_fixed_posture_touches():
    scene, setup = scene_with_post(0.9, -0.3), GENERATOR.setup
    found = driven(scene, AvoidingBody(setup, scene.poses))
    assert found["completed"] and found["least_gap_mm"] > 20.0
    assert found["tool_rms_mm"] < 1.0 and found["tool_max_mm"] < 3.0
    blind = driven(scene, FixedPosture(setup, scene.poses))
    assert blind["contact"]
    waiting = driven(scene, FixedPosture(setup, scene.poses, scene.things))
    assert not waiting["completed"] and not waiting["contact"]


def test_a_tool_that_may_tilt_stays_in_its_cone_where_it_is_executed():
    scene = scene_with_post(0.9, -1.2)
    scene.poses[:, 2, 3] += np.linspace(0.0, 0.5, 12)
    freedom = OrientationFreedom("z", cone=0.2, pivot=0.1)
    driver = AvoidingBody(replace(GENERATOR.setup, freedom=freedom), scene.poses)
    robot = dict(robot_parameters(resolve_robot("omniman")))
    record = BodyLoop(robot, "ideal", scene, START[3:], 1).run(driver, 12.0)
    found = figures_of(judged(GENERATOR, scene, record), scene.fixed.duration)
    assert found["completed"] and found["tool_rms_mm"] < 1.0
    joints = np.array(record.arm)[:, 1:7]
    platform = columns_at(np.array(record.platform)[:, :4], np.array(record.arm)[:, 0])
    axis = GENERATOR.model.forward(np.hstack([platform, joints]))[:, :3, 2]
    tilt = np.arccos(np.clip(axis @ scene.poses[0, :3, 2], -1.0, 1.0))
    assert 0.1 < tilt.max() <= freedom.cone


def test_an_impossible_path_ends_with_the_reason():
    scene = scene_with_post(*GENERATOR.model.forward(START)[:2, 3] + [0.5, 0.0])
    found = driven(scene, AvoidingBody(GENERATOR.setup, scene.poses))
    assert not found["completed"] and "thing 0" in found["stop"]
