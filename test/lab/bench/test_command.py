import json
import subprocess

import pytest

from omniman_ros.lab.bench.control import aims
from omniman_ros.lab.bench.control_tick import core_ticks
from test import robots
from test.running import command, environment


@pytest.mark.parametrize("name", robots.ALL)
def test_core_ticks_are_measured_in_every_mode_and_for_every_robot(name):
    ticks = core_ticks(robots.values(name), blocks=2, block=50)
    assert set(ticks) == {"velocity", "torque", "voltage"}
    assert all(1.0 < micros < 5000.0 for micros in ticks.values())


def test_aims_are_met_or_missed():
    result = {
        "core_tick_us": {"velocity": 50.0, "torque": 99.0},
        "latency_ratio": 1.3,
        "cpu_share": {"platform_controller": 0.33},
    }
    assert aims(result) == {"core_tick": True, "latency_ratio": True, "cpu_share": True}
    result["core_tick_us"]["torque"] = 101.0
    result["latency_ratio"] = 1.31
    result["cpu_share"]["platform_controller"] = 0.34
    assert aims(result) == {"core_tick": False, "latency_ratio": False, "cpu_share": False}


@pytest.mark.processes
@pytest.mark.exhaustive
def test_benchmark_runs_end_to_end_and_publishes_its_json(tmp_path):
    ended = subprocess.run(
        command("bench", "control", "--quick", "--results", str(tmp_path)),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    result = json.loads(ended.stdout.splitlines()[-1])
    assert result == json.loads((tmp_path / "bench_control.json").read_text())
    assert result["quick"] is True
    for name in ("platform_controller", "relay"):
        assert result["latency"][name]["samples"] == 20
        assert result["latency"][name]["median_ms"] > 0.0
    assert result["latency_ratio"] > 0.0
    assert result["cpu_share"]["platform_controller"] > 0.0
    assert result["cpu_share"]["simulated_drive"] > 0.0
