import math
import os

import pytest

from omniman_ros.lab.bench.soak import aims, report
from omniman_ros.lab.soak.usage import Usage, longest_life, usage, usage_figures


def life(pid, memory, seconds=1200.0, descriptors=lambda t: 14, cpu=0.2):
    times = [seconds * k / 40 for k in range(41)]
    return [Usage(t, pid, memory(t), descriptors(t), 16, cpu * t) for t in times]


def result(**changes):
    figures = {"processes": {"node": usage_figures(life(1, lambda t: 80.0))}}
    figures |= {"least_gap_m": 0.1, "fastest_m_s": 1.0, "speed_limit_m_s": 1.1}
    figures |= {"ended": [], "stuck": "", "false_stops": [], "held_up_stops": 0, "unanswered": []}
    figures |= {"activities": {"goal": 3}, "load": 1.0, "driven_min": 2.0}
    return figures | changes


def test_growth_is_the_slope_of_the_settled_part():
    filling = usage_figures(life(1, lambda t: 80.0 + 20.0 * min(t / 600.0, 1.0)))
    assert filling["memory_growth_MiB_per_hour"] == pytest.approx(0.0, abs=1e-6)
    leaking = usage_figures(life(1, lambda t: 80.0 + 36.0 * t / 3600.0))
    assert leaking["memory_growth_MiB_per_hour"] == pytest.approx(36.0)
    assert leaking["cpu_share"] == pytest.approx(0.2)
    assert math.isnan(usage_figures(life(1, lambda t: 80.0)[:2])["memory_growth_MiB_per_hour"])


def test_a_process_that_was_started_anew_is_judged_by_its_longest_life():
    samples = [*life(1, lambda t: 80.0)[:5], *life(2, lambda t: 90.0)]
    assert {sample.pid for sample in longest_life(samples)} == {2}
    assert longest_life([]) == []


def test_own_usage_is_read_and_that_of_a_process_that_has_ended_is_none():
    own = usage(os.getpid(), 1.0)
    assert own.memory > 10.0 and own.descriptors > 2 and own.threads >= 1 and own.cpu > 0.0
    assert usage(999999999, 1.0) is None


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, set()),
        ({"least_gap_m": -0.001}, {"contact"}),
        ({"fastest_m_s": 1.2}, {"speed"}),
        ({"ended": ["can_bridge"]}, {"processes"}),
        ({"stuck": "still moving"}, {"reset"}),
        ({"false_stops": ["x"]}, {"false_stops"}),
        (
            {"processes": {"node": usage_figures(life(1, lambda t: 80.0 + t / 60.0))}},
            {"memory"},
        ),
        (
            {
                "processes": {
                    "node": usage_figures(life(1, lambda t: 80.0, descriptors=lambda t: int(t)))
                }
            },
            {"counts"},
        ),
    ],
)
def test_aims_are_met_or_missed(changes, missed):
    figures = result(**changes)
    figures["aims"] = aims(figures)
    assert {key for key, good in figures["aims"].items() if good is False} == missed
    assert any("node" in line for line in report(figures))


def test_memory_is_not_judged_after_a_short_run():
    short = usage_figures(life(1, lambda t: 80.0 + t, seconds=180.0))
    assert aims(result(processes={"node": short}))["memory"] is None
