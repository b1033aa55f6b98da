"""The steps of putting a simulated robot to a place."""

import math

import pytest

from omniman_ros.nodes.viewing.placing import ARRIVAL, PATIENCE, QUIET, Placing, Step

THERE = (1.0, 2.0, 0.5)
ELSEWHERE = (0.0, 0.0, 0.0)


def test_it_waits_until_the_robot_stands_and_places_it_once():
    placing = Placing(THERE, 10.0)
    assert placing.step(False, ELSEWHERE, 10.0) is Step.WAIT
    assert placing.step(False, ELSEWHERE, 11.0) is Step.WAIT
    assert placing.step(True, ELSEWHERE, 11.1) is Step.PLACE
    assert placing.step(True, ELSEWHERE, 11.2) is Step.WAIT


def test_a_robot_that_does_not_come_to_rest_is_not_placed():
    placing = Placing(THERE, 10.0)
    assert placing.step(False, ELSEWHERE, 10.0 + PATIENCE) is Step.WAIT
    assert placing.step(False, ELSEWHERE, 10.01 + PATIENCE) is Step.LATE


@pytest.mark.parametrize("odom", [THERE, (1.02, 2.0, 0.5 + math.tau), None])
def test_it_is_done_when_odometry_says_so_or_is_not_there(odom):
    placing = Placing(THERE, 10.0)
    placing.step(True, ELSEWHERE, 10.0)
    assert placing.step(True, odom, 9.99 + QUIET) is Step.WAIT, "no goal would be heard"
    assert placing.step(True, odom, 10.01 + QUIET) is Step.DONE


@pytest.mark.parametrize("odom", [ELSEWHERE, (1.0, 2.0, 0.6), (1.06, 2.0, 0.5)])
def test_odometry_that_does_not_follow_is_told(odom):
    placing = Placing(THERE, 10.0)
    placing.step(True, odom, 10.0)
    assert placing.step(True, odom, 10.0 + ARRIVAL) is Step.WAIT
    assert placing.step(True, odom, 10.01 + ARRIVAL) is Step.LOST
