import json
import subprocess

import pytest

from omniman_ros.lab.bench.nodes import aims, report
from test.running import command, environment


def result(tick, start):
    return {
        "tick_us": {"platform_controller": tick, "bare_controller": 300.0},
        "tick_ratio": tick / 300.0,
        "start_s": {"platform_controller": start, "bare_controller": 0.3},
        "start_cpu_s": {"platform_controller": 0.3, "bare_controller": 0.2},
    }


@pytest.mark.parametrize(
    ("tick", "start", "met"),
    [(400.0, 0.6, (True, True)), (401.0, 0.5, (False, True)), (390.0, 0.61, (True, False))],
)
def test_aims_are_met_or_missed_and_printed(tick, start, met):
    measured = result(tick, start)
    measured["aims"] = aims(measured)
    assert measured["aims"] == dict(zip(("tick", "start"), met, strict=True))
    text = "\n".join(report(measured))
    assert text.count("MISSED") == met.count(False)
    assert f"{tick:.0f} us" in text and f"{start:.2f} s" in text


@pytest.mark.processes
@pytest.mark.exhaustive
def test_benchmark_compares_the_node_with_a_bare_one(tmp_path):
    ended = subprocess.run(
        command("bench", "nodes", "--quick", "--results", str(tmp_path)),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    measured = json.loads((tmp_path / "bench_nodes.json").read_text())
    assert measured["tick_us"]["platform_controller"] > measured["tick_us"]["bare_controller"] > 50
    assert measured["start_cpu_s"]["platform_controller"] > 0.05
