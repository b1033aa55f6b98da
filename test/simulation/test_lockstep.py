"""Lockstep: simulated time waits for the slowest participant that is alive."""

import pytest

from omniman_ros.simulation.lockstep import Lockstep

PATIENCE = 5.0


@pytest.fixture
def lockstep():
    return Lockstep(PATIENCE)


def test_without_participants_time_never_waits(lockstep):
    assert lockstep.laggards(1e9) == []
    assert lockstep.drop_dead(1e9, 0.0) == []


def test_time_goes_on_up_to_the_lowest_permit(lockstep):
    lockstep.permit("fast", 3.0)
    lockstep.permit("slow", 2.0)
    assert lockstep.laggards(2.0) == []
    assert lockstep.laggards(2.001) == ["slow"]
    assert lockstep.laggards(3.001) == ["fast", "slow"]
    lockstep.permit("slow", 2.1)
    assert lockstep.laggards(2.1) == []


def test_a_step_may_be_as_long_as_a_participant_permits(lockstep):
    now, step = 0.0, 0.01
    for _ in range(1000):
        lockstep.permit("node", round(1e9 * now) * 1e-9 + step)
        assert lockstep.laggards(now + step) == []
        now += step


def test_participant_that_leaves_is_not_waited_for_until_its_next_permit(lockstep):
    lockstep.permit("node", 1.0)
    lockstep.leave("node")
    assert lockstep.laggards(2.0) == []
    lockstep.permit("node", 1.5)
    assert lockstep.laggards(2.0) == ["node"]


def test_participant_is_given_up_after_the_patience_and_not_before(lockstep):
    lockstep.permit("stopped", 1.0)
    lockstep.permit("healthy", 2.0)
    for waited in (0.0, 1.0, PATIENCE):
        assert lockstep.drop_dead(1.91, 100.0 + waited) == []
    assert lockstep.drop_dead(1.91, 100.1 + PATIENCE) == ["stopped"]
    assert lockstep.laggards(1.91) == []


def test_patience_begins_anew_with_each_wait(lockstep):
    """A slow participant that gets on is never given up, however long it takes altogether."""
    for k in range(10):
        lockstep.permit("slow", float(k))
        assert lockstep.drop_dead(k + 1.0, k * 0.9 * PATIENCE) == []
        assert lockstep.drop_dead(k + 1.0, (k + 0.89) * 0.9 * PATIENCE) == []
        lockstep.permit("slow", k + 1.0)
        assert lockstep.drop_dead(k + 1.0, (k + 0.9) * 0.9 * PATIENCE) == []


def test_patience_of_zero_waits_for_nobody_twice():
    lockstep = Lockstep(0.0)
    lockstep.permit("slow", 0.0)
    lockstep.drop_dead(1.0, 10.0)
    assert lockstep.drop_dead(1.0, 10.001) == ["slow"]
