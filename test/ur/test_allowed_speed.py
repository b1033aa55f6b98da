"""The share of the joints' speed limits that is left."""

import numpy as np
import pytest

from omniman_ros.ur.allowed_speed import REACTION_TIME, AllowedSpeed
from omniman_ros.ur.joint_guard import JointLimits

DT = 0.008
LIMITS = JointLimits(
    names=("first", "second"),
    lower=np.full(2, -6.0),
    upper=np.full(2, 6.0),
    velocity=np.full(2, 3.0),
    acceleration=np.full(2, 5.0),
    distance=np.full(2, 1.0),
)


def run(allowed, used, seconds):
    """Let time pass while the joints use a share of their speed; return the values."""
    values = []
    for _ in range(round(seconds / DT)):
        allowed.step(np.array([0.0, 3.0 * used]), LIMITS, DT)
        values.append(allowed.value)
    return np.array(values)


def test_a_share_below_the_speed_that_is_used_applies_after_the_reaction_time():
    allowed = AllowedSpeed()
    allowed.target = 0.3
    values = run(allowed, 0.4, 0.3)
    late = round(REACTION_TIME / DT) + 1
    assert values[: late - 2].min() == 1.0
    assert values[late] < 0.4
    assert values[-1] == 0.3
    falls = -np.diff(values[late:])
    assert falls.max() <= 5.0 / 3.0 * DT + 1e-12


def test_a_source_that_slows_down_within_the_reaction_time_is_never_too_fast():
    allowed, fraction = AllowedSpeed(), 1.0
    fractions = []
    for _ in range(300):
        fractions.append(fraction)
        allowed.target = fraction
        late = fractions[max(0, len(fractions) - 1 - round(REACTION_TIME / DT))]
        velocity = np.array([3.0 * late, 0.0])
        allowed.step(velocity, LIMITS, DT)
        assert not allowed.is_exceeded(velocity, LIMITS)
        fraction *= 1.0 - DT
    assert fraction < 0.1


def test_a_share_that_rises_applies_at_once():
    allowed = AllowedSpeed()
    allowed.target = 0.0
    assert run(allowed, 0.1, 0.4)[-1] == 0.0
    allowed.target = 0.7
    assert run(allowed, 0.0, DT)[-1] == pytest.approx(0.7)
