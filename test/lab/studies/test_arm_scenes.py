"""Scenes with the arm in random postures, and their judge in three dimensions."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the physics engine judges")

from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.studies.arm_scenes import ABOVE, ArmBody, arm_scene, judge_arm_drive
from omniman_ros.lab.studies.scene_generator import MARGIN, Mismatch, RandomScene, scene
from omniman_ros.lab.studies.scene_geometry import Ellipse, PolylineMotion
from omniman_ros.lab.studies.scenes import SceneDrive, box_of
from test import robots

VALUES = robots.values("omniman")
DESCRIPTION = build(DescriptionParameters, VALUES)
STRETCHED = (0.0,) * 6
"""Ahead, its axis 0.6 m above the floor; the wrist ends 0.92 + 0.2 m ahead of base_link."""
GOAL = (2.0, 0.0, 0.0)


def made(*rows):
    """Return a scene from rows of an obstacle's x, y, radius and heights."""
    obstacles = tuple(Ellipse((r, r), PolylineMotion.still(x, y)) for x, y, r, _ in rows)
    blank = RandomScene(0, (0.0, 0.0, 0.0), GOAL, obstacles, None, False, Mismatch())
    return replace(blank, posture=STRETCHED, heights=tuple(row[3] for row in rows))


def ahead(count=400):
    share = np.linspace(0.0, 1.0, count)
    poses = share[:, None] * np.array(GOAL)
    return SceneDrive(4.0 * share, poses, 1.0, True, np.array([0.01]), 0, 0.0, "arrived", "")


def judged(there, drive=None):
    return judge_arm_drive(there, drive or ahead(), DESCRIPTION)


@pytest.mark.parametrize(
    ("heights", "touched"),
    [
        ((0.0, ABOVE), True),
        ((0.55, 0.6), True),
        ((0.0, 0.3), False),  # below the wrist, and the platform does not get there
        ((0.9, ABOVE), False),
    ],
)
def test_the_arm_touches_only_what_is_at_its_height(heights, touched):
    outcome = judged(made((2.75, 0.0, 0.1, heights)))
    assert outcome.verdict.collided == touched == outcome.failed
    assert outcome.reached != touched
    if touched:  # the arm ends about 1.1 m ahead
        assert 0.5 * outcome.verdict.contact == pytest.approx(2.65 - 1.1, abs=0.1)


def test_a_contact_between_two_samples_is_found():
    thin = made((1.8, 0.0, 0.01, (0.0, ABOVE)))
    jump = replace(ahead(2), times=np.array([0.0, 1.0]), poses=np.array([[0, 3, 0], [0, -3, 0.0]]))
    assert judged(thin, jump).verdict.collided
    assert judged(made(), jump).verdict.gap == math.inf


def test_the_least_gap_is_found():
    beside = judged(made((1.5, 0.6, 0.1, (0.0, 0.4))))
    assert beside.verdict.gap == pytest.approx(0.6 - 0.1 - 0.35, abs=0.006)


def test_a_scene_has_heights_and_a_posture_with_room():
    there, plain = arm_scene(1, box_of(VALUES), DESCRIPTION), scene(1, box_of(VALUES))
    assert there == arm_scene(1, box_of(VALUES), DESCRIPTION)
    assert (there.start, there.goal, there.obstacles) == (plain.start, plain.goal, plain.obstacles)
    assert len(there.heights) == len(there.obstacles) and len(there.posture) == 6
    assert all(0.0 <= low < high <= ABOVE for low, high in there.heights)
    body = ArmBody(DESCRIPTION, there)
    body.place(0.0, np.array(there.start))
    assert body.gaps().min() >= MARGIN
