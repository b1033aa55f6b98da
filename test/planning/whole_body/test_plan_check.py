"""The check of motions, and what plans keep from, on the robot of the paper."""

import numpy as np
import pytest

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.plan_check import CONSUMED
from omniman_ros.planning.whole_body.task import WholeBodyTask
from test.planning.whole_body.support import START, posts, setup, straight

SETUP = setup()
STEP = 0.001  #: Approach of a motion [m]


@pytest.fixture(scope="module")
def task():
    return WholeBodyTask(SETUP, straight(0.8), START, 0.0, ObstacleSnapshot())


def shifted(y, step, seconds=0.1):
    """Return a motion of the platform to the side [m]; the tool stays."""
    z = np.zeros((2, 4))
    z[:, 1] = y, y + step
    return HermiteTrajectory(np.array([0.0, seconds]), z, np.zeros((2, 4)), np.zeros((1, 0)))


def test_small_approaches_do_not_add_up_and_who_is_too_near_may_leave(task):
    around = posts((0.0, -0.6))

    def judged(motion):
        return task.controller._check.judge([motion], 0.0, 0.1, around)[0]

    def gap(y):
        pose = np.array([[0.0, y, 0.0]])
        return float(task.controller._gaps.platform(pose, around.standing).min())

    y = 0.0
    assert gap(y) > SETUP.dodge.least_clearance
    while y > -0.2 and judged(shifted(y, -STEP)).is_clear:
        y -= STEP
    least = SETUP.dodge.least_clearance - CONSUMED
    assert least - 1e-5 <= gap(y) < least + STEP
    for nearer in (0.5 * CONSUMED, 3.0 * CONSUMED):
        y = y - (gap(y) - (SETUP.dodge.least_clearance - nearer))
        assert judged(shifted(y, STEP)).is_clear, "it leaves"
    verdict = judged(shifted(y, -0.1 * STEP))
    assert not verdict.is_clear and verdict.obstructed_at <= 0.1


def test_what_is_touched_already_does_not_hide_what_would_be_touched_next(task):
    """A post that overlaps the platform is behind it; another one is to its side."""
    around = posts((-0.4, 0.0), (0.0, -0.6))
    motions = [shifted(0.0, -0.3, 3.0), shifted(0.0, 0.1, 3.0)]
    aside, away = task.controller._check.judge(motions, 0.0, 3.0, around)
    assert 0.5 < aside.contact < 3.0 and away.contact == np.inf and away.gap < 0.0


def walker(speed):
    """Return what walks along x, beside the robot."""
    obstacle = UprightObstacles.cylinder(0.3, -0.9, 0.25, (0.0, 1.8))
    return ObstacleSnapshot(
        moving=MovingObstacles(obstacle, np.array([[speed], [0.0]])), growth=np.array([0.05])
    )


def test_plans_keep_farther_from_what_moves_faster_whatever_the_pace(task):
    at = task.redundancy.configurations(np.zeros((1, 4)))
    gaps = BodyGaps(SETUP.description, SETUP.tool, None, 0.1, time_gap=0.35)

    def nearest(around):
        return float(gaps.rows(at, around, np.zeros(1), 5.0, 40).gap.min())

    bare = BodyGaps(SETUP.description, SETUP.tool, None, 0.1)
    kept = gaps.rows(at, walker(0.8), np.zeros(1), 5.0, 40)
    free = bare.rows(at, walker(0.8), np.zeros(1), 5.0, 40)
    moving = kept.kind[0] == kept.kind.max()
    difference = np.sort(free.gap[0][free.kind[0] == free.kind.max()]) - np.sort(
        kept.gap[0][moving]
    )
    assert difference == pytest.approx(0.35 * 0.8, abs=1e-9)
    slow = walker(0.8).slowed(1.0, 0.25)
    assert slow.time == 1.0 and slow.moving.velocity[0, 0] == pytest.approx(3.2)
    assert slow.growth[0] == pytest.approx(0.2)
    assert nearest(slow) == pytest.approx(nearest(walker(0.8)), abs=1e-9)


def test_a_step_out_of_reach_is_shortened(task, monkeypatch):
    steps, line = SETUP.dodge.steps, task.controller._linearisation
    times = 0.05 + 0.1 * np.arange(steps + 1.0)
    z, zero = np.zeros((steps + 1, 4)), np.zeros((steps + 1, 4))
    z[:, :3] = START[:3]

    class Far:
        states = np.zeros((steps, 8))

    Far.states[:, 0] = -1.2  # beyond the reach of the arm, half of it is not
    monkeypatch.setattr(line._program, "solve", lambda rows, cost: Far)
    better, _ = line.improved(z, zero, np.zeros((steps, 4)), times, task.way, ObstacleSnapshot())
    moved = (better - z)[1:, 0] / Far.states[0, 0]
    assert moved == pytest.approx(np.full(steps, moved[0])) and 0.2 < moved[0] < 0.6
    assert np.isfinite(task.redundancy.axes(better)).all()
