"""What is sent of a motion of the whole body, and what becomes of a robot that hears no more."""

import numpy as np
import pytest

from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.task import WholeBodyTask
from test.planning.whole_body.support import START, setup, straight

SETUP = setup()
MODEL = WholeBodyModel(SETUP.description.mount)
FREE = ObstacleSnapshot()


def followed(duration, pace=1.0):
    """Return a motion that has been followed for a time [s], and that time."""
    motion = AvoidanceMotion(SETUP.limits)
    motion.follow(WholeBodyTask(SETUP, straight(0.8), START, 0.0, FREE))
    now = 0.0
    while now < duration:
        motion.cycle(now, pace, FREE)
        now += PERIOD
    return motion, now - PERIOD


def test_what_is_sent_ends_at_rest_on_the_path_of_the_tool():
    motion, now = followed(2.0)
    assert motion.path_parameter(now + 0.4) - motion.path_parameter(now + 0.3) > 0.019
    rest = motion.time_to_rest(now, 1.0)
    assert 0.5 < rest < 1.6
    times = now + np.linspace(0.0, rest, 60)
    axes, velocity, _ = motion.sample(times)
    assert velocity[-1] == pytest.approx(np.zeros(9), abs=1e-6)
    tool, start = MODEL.forward(axes), MODEL.forward(START)
    assert np.abs(tool[:, 1:3, 3] - start[1:3, 3]).max() < 1e-6
    slowing = np.abs(np.diff(velocity[:, :2], axis=0)).max() / (times[1] - times[0])
    assert slowing <= SETUP.limits.acceleration[0]


@pytest.mark.parametrize("late", [0.3, 0.7, 3.0])
def test_a_robot_whose_planner_was_held_up_goes_on_from_where_it_brakes(late):
    motion, now = followed(2.0)
    times = now + late + np.array([0.0, PERIOD])
    before = motion.sample(times)[0]
    motion.cycle(now + late, 1.0, FREE)
    assert motion.sample(times)[0] == pytest.approx(before, abs=1e-6)
    assert motion.time_to_rest(now + late, 1.0) > 0.5


def test_a_slow_pace_does_not_brake_the_robot():
    # HPIPM ends at its tolerance: after 18 cycles, round-off alone would have become 2e-4 m/s.
    motion, now = followed(0.6, pace=0.1)
    sent = motion.sent.at(np.array([now, now + 0.1]))[1]
    fast, _ = followed(0.6, pace=0.7)  # at most: from there on, plans begin later for the arm
    assert sent == pytest.approx(fast.sent.at(np.array([now, now + 0.1]))[1], abs=1e-6)


def test_a_pause_brakes_what_is_sent():
    motion, now = followed(2.0)
    motion.pause(now)
    assert motion.state is PathState.PAUSING
    assert motion.time_to_rest(now, 1.0) < 0.9
    motion.update(now + 1.0)
    assert motion.state is PathState.PAUSED
