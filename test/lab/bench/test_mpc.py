import argparse
import copy
import json
import os

import pytest

from omniman_ros.lab.bench import command as bench
from omniman_ros.lab.bench import mpc as bench_mpc
from omniman_ros.lab.bench.mpc import (
    aims,
    case_name,
    cost_statistics,
    drive_statistics,
    ratios,
    spread,
)


def figures(median, p99=None):
    return {
        "median_ms": median,
        "p99_ms": p99 or 2 * median,
        "max_ms": 3 * median,
        "steps": 9,
        "failures": 0,
    }


def solved(cycle, **peers):
    found = {"cycle": figures(cycle), "solver": figures(0.5 * cycle)}
    return found | {peer: figures(*times) for peer, times in peers.items()}


MEASURED = {
    "alone": {"N=10 M=4": solved(2.0), "N=20 M=4": solved(5.0), "N=10 M=10": solved(5.0)},
    "peers": {"N=10 M=4": solved(2.0, ipopt=(15.0, 20.0), fatrop=(20.0, 90.0))},
    "closed_loop": {"N=10": {"scenes": 3, "same_sides": 3, "median_ratio": 1.02}},
}
"""Every aim just met."""


def judged(measured):
    return aims(measured | {"ratios": ratios(measured)})


def test_ratios_are_peer_over_own_solver():
    over = ratios(MEASURED)
    assert over["ipopt_over_cycle"] == {"median": 7.5, "p99": 5.0}
    assert over["ipopt_over_solver"] == {"median": 15.0, "p99": 10.0}
    assert over["fatrop_over_cycle"] == {"median": 10.0, "p99": 22.5}
    assert over["N=20_over_N=10"] == 2.5 and over["M=10_over_M=4"] == 2.5
    assert over["N=40_over_N=20"] is None


def test_aims_are_met_at_their_bounds():
    assert judged(MEASURED) == dict.fromkeys(("median", "p99", "steps", "obstacles", "cost"), True)


@pytest.mark.parametrize(
    ("aim", "keys", "value"),
    [
        ("median", ("peers", "N=10 M=4", "ipopt", "median_ms"), 14.9),
        ("p99", ("peers", "N=10 M=4", "ipopt", "p99_ms"), 19.9),
        ("steps", ("alone", "N=20 M=4", "cycle", "median_ms"), 5.01),
        ("obstacles", ("alone", "N=10 M=10", "cycle", "median_ms"), 5.01),
        ("cost", ("closed_loop", "N=10", "median_ratio"), 1.021),
    ],
)
def test_each_aim_is_missed_alone(aim, keys, value):
    measured = copy.deepcopy(MEASURED)
    at = measured
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    assert [key for key, met in judged(measured).items() if not met] == [aim]


def test_aim_that_was_not_measured_is_neither_met_nor_missed():
    measured = copy.deepcopy(MEASURED)
    del measured["alone"]["N=20 M=4"], measured["alone"]["N=10 M=10"]
    measured["closed_loop"]["N=10"]["median_ratio"] = None
    found = judged(measured)
    assert found["steps"] is None and found["obstacles"] is None and found["cost"] is None


def test_spread_is_in_milliseconds():
    assert spread([0.001] * 99 + [0.005]) == pytest.approx(
        {"median_ms": 1.0, "p99_ms": 1.04, "max_ms": 5.0}
    )


def test_costs_count_as_different_only_beyond_a_fraction():
    found = cost_statistics([-0.5, 0.0, 0.01, 0.03])
    assert found["median_above"] == pytest.approx(0.005) and found["steps"] == 4
    assert found["share_worse"] == 0.25 and found["share_better"] == 0.25


def test_drives_on_other_sides_are_counted_but_not_compared():
    def row(ratio, same):
        return {"ratio": ratio, "same_sides": same, "failures": {"ours": 1, "ipopt": 0}}

    found = drive_statistics(
        [row(1.0, True), row(1.1, True), row(1.3, True), row(0.5, False), row(9, False)]
    )
    assert found["median_ratio"] == 1.1 and found["worst_ratio"] == 1.3
    assert found["scenes"] == 5 and found["same_sides"] == 3
    assert found["other_sides_better"] == found["other_sides_worse"] == 1
    assert found["failures"] == {"ours": 5, "ipopt": 0}
    assert drive_statistics([row(2.0, False)])["median_ratio"] is None


@pytest.mark.exhaustive
def test_benchmark_runs_end_to_end_and_publishes_its_json(tmp_path, monkeypatch, capsys):
    tiny = bench_mpc.Effort(((10, 4),), (bench_mpc.MAIN,), 3, 3, 3, 1, (10,), 3, False)
    monkeypatch.setattr(bench_mpc, "QUICK", tiny)
    monkeypatch.setattr(bench_mpc.os, "environ", dict(os.environ))
    args = argparse.Namespace(name="mpc", quick=True, robot="ig42", results=str(tmp_path))
    assert bench.run(args) == 0
    result = json.loads((tmp_path / "bench_mpc.json").read_text())
    assert result == json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["robot"] == "ig42" and result["quick"] is True
    main = result["peers"][case_name(bench_mpc.MAIN)]
    for who in ("cycle", "solver", "ipopt", "fatrop"):
        assert main[who]["steps"] == 3
        assert 0.0 < main[who]["median_ms"] <= main[who]["p99_ms"] <= main[who]["max_ms"]
    assert main["solver"]["median_ms"] < main["cycle"]["median_ms"] < main["ipopt"]["median_ms"]
    assert main["cost_of_a_step"]["steps"] == 3
    assert result["alone"]["N=10 M=4"]["cycle"]["failures"] == 0
    loop = result["closed_loop"]["N=10"]
    assert loop["scenes"] == 1 and loop["drives"][0]["cost_J"]["ours"] > 0.0
    assert set(result["aims"]) == {"median", "p99", "steps", "obstacles", "cost"}
    assert result["ratios"]["ipopt_over_cycle"]["median"] > 1.0
