"""`omniman reproduce dodge`."""

import numpy as np
import pytest

from omniman_ros.lab.reproduce import dodge
from omniman_ros.lab.reproduce.dodge import AVOIDS, KEEPS, drive_row, report, scene_of
from omniman_ros.lab.studies.avoidance_scenes import START, SceneGenerator
from omniman_ros.simulation.world.distances import ConfigurationDistances
from test.lab.studies.test_body_judge import made

GENERATOR = SceneGenerator("omniman")


@pytest.mark.parametrize(
    ("changes", "kept"),
    [
        ({"off": 0.0009, "peak": 0.0029}, True),
        ({"off": 0.0011}, False),
        ({"off": 0.0005, "peak": 0.0031}, False),
        ({"touches": (10,)}, False),
        ({"touches": (10,), "rate": 0.0}, True),
        ({"completed_at": None}, False),
    ],
)
def test_each_aim_counts_and_the_report_says_which_is_missed(changes, kept):
    row = drive_row(AVOIDS, made(**changes))
    assert row["kept"] is kept
    bounds = {"rms_mm": 1.0, "max_mm": 3.0}
    lines = report({"drives": [row], "bounds": bounds, "unhindered_s": 20.0})
    assert lines[-1].count("MISSED") == (not kept)


def test_persons_are_where_they_cross_at_their_time():
    scene = scene_of(GENERATOR, dodge.LENGTH)
    for k, (place, time, velocity) in enumerate(dodge.CROSSING, len(dodge.STANDING)):
        assert scene.places_at(time)[k] == pytest.approx(place)
        assert scene.velocities[k] == pytest.approx(velocity)


@pytest.mark.parametrize("length", [dodge.QUICK_LENGTH, dodge.LENGTH])
def test_the_robot_has_room_at_the_start_and_none_on_its_way_as_it_is(length):
    scene = scene_of(GENERATOR, length)
    assert scene.fixed.duration > length / GENERATOR.setup.path.linear_velocity
    judge = ConfigurationDistances(GENERATOR.setup.description, scene.things)
    judge.place(START[:3], START[3:], scene.places)
    assert judge.distances(1.0).min() > 0.3
    least = np.full(len(scene.things), 1.0)
    for now in np.linspace(0.0, scene.fixed.duration, 200).tolist():
        q = scene.fixed.sample(np.array([now]))[0][0]
        judge.place(q[:3], q[3:], scene.places_at(now))
        least = np.minimum(least, judge.distances(1.0))
    blocked = np.count_nonzero(least <= 0.0)
    assert blocked >= (2 if length == dodge.QUICK_LENGTH else 3), least


def test_the_picture_shows_each_thing_where_it_is_nearest(tmp_path):
    figures = pytest.importorskip("omniman_ros.lab.body_figures")
    scene = scene_of(GENERATOR, dodge.QUICK_LENGTH)
    count = round(1.0 / 0.025)
    gaps = np.full((count, len(scene.things)), 0.5)
    gaps[10, 0] = gaps[20, 1] = 0.2
    drives = {AVOIDS: made(gaps=gaps), KEEPS: made(gaps=gaps, touches=(10,))}
    path = tmp_path / "dodge.png"
    figures.draw_dodge(GENERATOR, scene, drives, (0.001, 0.003), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert figures.plt.get_fignums() == []
