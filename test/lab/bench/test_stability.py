import json

import pytest

from omniman_ros.cli.main import main
from omniman_ros.console.errors import CommandError
from omniman_ros.lab.bench import stability as bench
from omniman_ros.robots import load_robot

TRACKING = {"speed_error": 0.05, "yaw_error": 0.004}
TIPPING = {"share": 0.4, "speed": 0.6, "least_load": 100.0, "lifted": 0.0, "tilt": 0.001}


def result(case="tipping", **changes):
    made = {"tracking": {}, "tipping": {}, "swing": {}, "silence": {}}
    for side in ("unknown", "known"):
        made["tracking"][side] = dict(TRACKING, yaw_error=0.01 if side == "unknown" else 0.004)
        for stop in ("tipping", "swing", "silence"):
            made[stop][side] = {**TIPPING, "stop_way": 0.169}
    made[case]["known"].update(changes)
    return {**made, "aims": bench.aims(made)}


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, set()),
        ({"case": "tracking", "yaw_error": 0.006}, {"yaw_error"}),
        ({"lifted": 0.005}, {"tipping_lifted"}),
        ({"stop_way": 0.18}, {"tipping_stop_way"}),
        ({"case": "swing", "stop_way": 0.18}, set()),
        ({"case": "silence", "stop_way": 0.3}, set()),
        ({"case": "silence", "lifted": 0.005}, {"silence_lifted"}),
        ({"case": "swing", "stop_way": 0.19, "lifted": 0.1}, {"swing_stop_way", "swing_lifted"}),
    ],
)
def test_a_missed_aim_is_reported_as_missed(changes, missed):
    made = result(**changes)
    assert {key for key, good in made["aims"].items() if not good} == missed
    assert sum("MISSED" in line for line in bench.report(made)) == len(missed)


def test_a_robot_without_an_arm_is_refused():
    with pytest.raises(CommandError, match="no arm"):
        bench.measure(load_robot("ig42"), 1.0)


@pytest.mark.exhaustive
def test_the_benchmark_meets_its_aims(tmp_path):
    pytest.importorskip("mujoco")
    assert main(["bench", "stability", "--results", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "bench_stability.json").read_text())
    assert all(written["aims"].values())
    assert written["tipping"]["unknown"]["lifted"] > 0.3
    assert written["swing"]["unknown"]["tilt"] > 0.05
