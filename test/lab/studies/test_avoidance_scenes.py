import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.lab.studies.avoidance_scenes import (
    PERSON,
    ROOM,
    START,
    TABLE,
    SceneGenerator,
)
from omniman_ros.simulation.world.distances import ConfigurationDistances


def test_a_scene_is_in_the_way_of_the_fixed_posture_and_clear_at_the_start():
    generator = SceneGenerator("omniman")
    scene = generator.scene("table", 0)
    assert scene is not None
    judge = ConfigurationDistances(generator.setup.description, [TABLE])
    judge.place(START[:3], START[3:], scene.places)
    assert judge.distances(1.0)[0] >= ROOM
    gaps = []
    for q in scene.fixed.sample(np.linspace(0.0, scene.fixed.duration, 40))[0]:
        judge.place(q[:3], q[3:], scene.places)
        gaps.append(judge.distances(1.0)[0])
    assert min(gaps) <= 0.0


def test_who_crosses_the_path_as_the_tool_arrives_delays_each_motion():
    scene = SceneGenerator("omniman").scene("table", 0)
    assert scene is not None
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, 0, 3] = np.linspace(0.05, 2.0, 40)
    speed, walking, time_gap, clearance = 0.2, 0.5, 0.2, 0.1
    alone = replace(scene, poses=poses)
    assert alone.least_time(speed, clearance, time_gap) == pytest.approx(2.0 / speed)
    across = replace(
        alone,
        things=(PERSON,),
        places=np.array([[1.0, -walking * 1.0 / speed]]),
        velocities=np.array([[0.0, walking]]),
    )
    # The place x at time t is free where |(x - 1, walking (t - 5))| >= room.
    room = max(PERSON.semi_axes) + clearance + time_gap * walking
    delay = room * math.hypot(1.0 / walking, 1.0 / speed)
    found = across.least_time(speed, clearance, time_gap)
    assert found == pytest.approx(2.0 / speed + delay, abs=0.05)
