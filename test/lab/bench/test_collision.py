import math

from omniman_ros.lab.bench import collision as bench
from omniman_ros.robots import load_robot


def test_a_missed_aim_is_reported_as_missed():
    figures = {"self_ms": 30.0, "solids_ms": 40.0, "one_configuration_us": 300.0}
    figures |= {"monitor_ms": 3.0, "monitor_moving_ms": 11.0}
    result = {"empty": figures, "loaded": figures}
    result["aims"] = bench.aims(result)
    assert list(result["aims"].values()) == [False, True, False]
    assert bench.report(result)[-1].startswith("aims missed: 1000 configurations")


def test_everything_is_measured(monkeypatch):
    monkeypatch.setattr(bench, "CONFIGURATIONS", 10)
    result = bench.measure(load_robot("omniman"), 1e-6)
    assert set(result) == set(bench.LOADS)
    assert all(0.0 < time < math.inf for part in result.values() for time in part.values())
