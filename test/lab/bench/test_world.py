import math

import pytest

from omniman_ros.cli.main import main
from omniman_ros.extras import WORLD, Extra
from omniman_ros.lab.bench import world as bench
from omniman_ros.robots import robot_parameters


def test_everything_is_measured():
    pytest.importorskip("mujoco")
    result = bench.measure(robot_parameters("ig42"), 0.05)
    assert set(result["factor"]) == {"plant", "ideal", "rollers"}
    assert all(0.0 < factor < math.inf for factor in result["factor"].values())
    assert result["scan"]["core_share"] == pytest.approx(40.0 * 1e-6 * result["scan"]["cpu_us"])


def test_without_the_engine_the_command_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(bench, "WORLD", Extra(("no_such_engine",), WORLD.need, WORLD.packages))
    assert main(["bench", "world", "--results", str(tmp_path)]) != 0
    assert "pip install 'mujoco-core==4.*'" in capsys.readouterr().err
