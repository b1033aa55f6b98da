"""The steps of the relocation of a simulated robot."""

import math

import pytest

from omniman_ros.viewer.ros.relocation import (
    ODOMETRY_TIMEOUT,
    REST_TIMEOUT,
    SOURCE_TIMEOUT,
    Relocation,
    RelocationStep,
)

THERE = (1.0, 2.0, 0.5)
ELSEWHERE = (0.0, 0.0, 0.0)


def test_a_relocation_waits_for_rest_and_moves_the_robot_once():
    relocation = Relocation(THERE, 10.0)
    assert relocation.step(False, ELSEWHERE, 10.0) is RelocationStep.WAIT
    assert relocation.step(False, ELSEWHERE, 11.0) is RelocationStep.WAIT
    assert relocation.step(True, ELSEWHERE, 11.1) is RelocationStep.MOVE
    assert relocation.step(True, ELSEWHERE, 11.2) is RelocationStep.WAIT


def test_a_robot_that_does_not_come_to_rest_is_not_moved():
    relocation = Relocation(THERE, 10.0)
    assert relocation.step(False, ELSEWHERE, 10.0 + REST_TIMEOUT) is RelocationStep.WAIT
    assert relocation.step(False, ELSEWHERE, 10.01 + REST_TIMEOUT) is RelocationStep.NOT_AT_REST


@pytest.mark.parametrize("odom", [THERE, (1.02, 2.0, 0.5 + math.tau), None])
def test_a_relocation_ends_when_odometry_follows_or_is_missing(odom):
    relocation = Relocation(THERE, 10.0)
    relocation.step(True, ELSEWHERE, 10.0)
    assert relocation.step(True, odom, 9.99 + SOURCE_TIMEOUT) is RelocationStep.WAIT, (
        "a goal would not be accepted yet"
    )
    assert relocation.step(True, odom, 10.01 + SOURCE_TIMEOUT) is RelocationStep.DONE


@pytest.mark.parametrize("odom", [ELSEWHERE, (1.0, 2.0, 0.6), (1.06, 2.0, 0.5)])
def test_odometry_that_does_not_follow_is_reported(odom):
    relocation = Relocation(THERE, 10.0)
    relocation.step(True, odom, 10.0)
    assert relocation.step(True, odom, 10.0 + ODOMETRY_TIMEOUT) is RelocationStep.WAIT
    assert relocation.step(True, odom, 10.01 + ODOMETRY_TIMEOUT) is RelocationStep.ODOMETRY_LOST
