import math

import pytest

from omniman_ros.cli.main import main
from omniman_ros.extras import WORLD, Extra
from omniman_ros.lab.bench import world as bench
from omniman_ros.robots import load_robot

RESULT = {
    "factor": {"plant": 11.0, "ideal": 6.5, "rollers": 4.5},
    "node": {
        "ideal": {"rest": 20.0, "driving": 29.0, "pace": 1.0},
        "rollers": {"rest": 31.0, "driving": 30.0, "pace": 0.9},
    },
    "scan": {"beams": 720, "cpu_us": 250.0, "core_percent": 1.0},
}


def test_a_missed_aim_is_reported_as_missed():
    result = {**RESULT, "aims": bench.aims(RESULT)}
    assert list(result["aims"].values()) == [True, False, True, False, True]
    missed = "rollers at least 5 times real time, simulated_world, rollers, at most 30 % of a core"
    assert bench.report(result)[-1] == f"aims missed: {missed}"


def test_everything_is_measured():
    pytest.importorskip("mujoco")
    result = bench.measure(load_robot("ig42"), 0.05)
    assert set(result["factor"]) == {"plant", "ideal", "rollers"}
    assert all(0.0 < factor < math.inf for factor in result["factor"].values())
    assert result["scan"]["core_percent"] == pytest.approx(
        100.0 * 40.0 * 1e-6 * result["scan"]["cpu_us"]
    )


def test_without_the_engine_the_command_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(bench, "WORLD", Extra(("no_such_engine",), WORLD.need, WORLD.packages))
    assert main(["bench", "world", "--results", str(tmp_path)]) != 0
    assert "pip install 'mujoco-core==4.*'" in capsys.readouterr().err
