import numpy as np

from omniman_ros.lab.studies.avoidance_scenes import ROOM, START, TABLE, SceneGenerator
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
