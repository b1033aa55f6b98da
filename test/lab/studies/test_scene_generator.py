import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_generator import AREA, MARGIN, ROBOT, Mismatch, blocks, scene
from omniman_ros.lab.studies.scene_geometry import (
    Ellipse,
    PolylineMotion,
    RectangularOutline,
    judge,
    outside,
)

SCENES = [scene(seed) for seed in range(48)]
STANDING = Mismatch()


def drive(times, poses, obstacles):
    return judge(np.array(times), np.array(poses), ROBOT, obstacles)


def test_scene_depends_on_its_seed_only():
    assert [scene(seed) for seed in (0, 7, 40)] == [SCENES[0], SCENES[7], SCENES[40]]
    assert len({made.start for made in SCENES}) == len(SCENES)


def test_four_consecutive_scenes_combine_blocking_and_model_mismatch():
    for first in range(0, 48, 4):
        four = SCENES[first : first + 4]
        assert [made.mismatch != STANDING for made in four] == [True, True, False, False]
        assert four[0].blocked and four[2].blocked


def test_blocked_flag_matches_contact_on_the_straight_line():
    assert any(not made.blocked for made in SCENES)
    fraction = np.linspace(0.0, 1.0, 4001)
    for made in SCENES:
        line = np.outer(1.0 - fraction, made.start) + np.outer(fraction, made.goal)
        fixed = [o for o in made.obstacles if o.is_fixed]
        hit = judge(
            fraction, line * [1.0, 1.0, 0.0], RectangularOutline(1e-6, 1e-6), fixed
        ).collided
        assert hit == made.blocked


@pytest.mark.parametrize(
    ("place", "angle", "expected"),
    [
        ((2, 0.45), 0.0, False),
        ((2, 0.45), math.pi / 2, True),
        ((-0.45, 0), 0.0, True),
        ((-0.55, 0), 0.0, False),
        ((4.2, 0), math.pi / 2, False),
    ],
)
def test_blocking_obstacle_reaches_the_line_between_its_ends(place, angle, expected):
    ellipse = Ellipse((0.5, 0.1), PolylineMotion.still(*place), angle)
    assert blocks(ellipse, (0, 0, 0), (4, 0, 0)) is expected


def test_start_is_clear_for_a_second_and_goal_of_standing_obstacles():
    for made in [*SCENES, scene(580), scene(774)]:
        at_start = drive([0.0, 1.0], [made.start] * 2, made.obstacles)
        assert at_start.gap >= MARGIN - 1e-9
        fixed = [o for o in made.obstacles if o.is_fixed]
        assert drive([0.0], [made.goal], fixed).gap >= MARGIN
        assert (outside(np.array([made.start, made.goal]), ROBOT, AREA) <= -MARGIN + 1e-9).all()


def test_negative_seed_is_refused():
    with pytest.raises(InputError, match="-1"):
        scene(-1)
