import numpy as np
import pytest

from omniman_ros.lab.bench import whole_body_obstacles as bench
from omniman_ros.lab.bench.dodge_scenes import ROOM, START, TABLE, SceneMaker
from omniman_ros.simulation.world.distances import PostureDistances


def row(**changes):
    return {
        "completed": True,
        "least_gap_mm": 50.0,
        "time_ratio": 1.1,
        "tool_rms_mm": 0.1,
        "tool_max_mm": 0.2,
        "search_s": 0.5,
        "cycle_ms": (5.0, 9.0, 60.0),
    } | changes


def test_contacts_refusals_and_missed_aims_are_reported():
    refused = {"completed": False, "refused": "no way", "least_gap_mm": None}
    scenes = [
        {"dodging": dodging, "fixed": row(least_gap_mm=-20.0), "waiting": row(completed=False)}
        for dodging in (row(), refused)
    ]
    result = {"methods": {method: bench.summary(scenes, method) for method in bench.METHODS}}
    assert result["methods"]["dodging"]["clear"] == 1
    assert result["methods"]["fixed"]["contacts"] == 2
    assert result["methods"]["waiting"]["clear"] == 0
    result["aims"] = bench.aims(result)
    missed = [label for label, is_met in result["aims"].items() if is_met is False]
    assert missed == ["97% completed", "every cycle in 50 ms"]
    assert bench.report(result)[-1] == "aims missed: 97% completed, every cycle in 50 ms"


def test_a_scene_is_in_the_way_of_the_fixed_posture_and_clear_at_the_start():
    setup = bench.Bench("omniman").setup
    scene = SceneMaker(setup).make("table", 0)
    judge = PostureDistances(setup.description, [TABLE])
    judge.place(START[:3], START[3:], scene.places)
    assert judge.distances(1.0)[0] >= ROOM
    gaps = []
    for q in scene.fixed.sample(np.linspace(0.0, scene.fixed.duration, 40))[0]:
        judge.place(q[:3], q[3:], scene.places)
        gaps.append(judge.distances(1.0)[0])
    assert min(gaps) <= 0.0
    assert scene.around(1.0, 0.1).standing.upper[0] == pytest.approx(TABLE.heights[1])
