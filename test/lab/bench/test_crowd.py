from omniman_ros.lab.bench import crowd as bench
from omniman_ros.lab.studies.crowd import CrowdRun


def result(contacts=0, taken=0.03, at_rest=2):
    runs = [CrowdRun(k, False, 30.0, 3, contacts, at_rest, (taken, taken)) for k in (0, 1)]
    found = {"crowds": {"crossing": bench.figures(runs)}}
    return found | {"aims": bench.aims(found)}


def test_a_missed_aim_is_reported_as_missed():
    assert result()["aims"] == {"contacts": True, "cpu": True}
    assert result(contacts=1)["aims"] == {"contacts": False, "cpu": True}
    assert result(taken=0.041)["aims"] == {"contacts": True, "cpu": False}
    assert sum("MISSED" in line for line in bench.report(result(contacts=1))) == 1
    assert result()["crowds"]["crossing"]["goals_per_minute"] == 6.0
