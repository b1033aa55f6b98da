from omniman_ros.lab.bench import clutter as bench
from omniman_ros.lab.studies.clutter import ClutterRun


def drives(*runs):
    found = {"drives": {bench.AIMED: bench.figures(runs)}}
    return found | {"aims": bench.aims(found)}


def run(seed=0, seconds=6.0, touched=()):
    return ClutterRun(seed, not touched, touched, seconds, 5.0, (0.01, 0.02))


def test_a_missed_aim_is_reported_as_missed():
    assert all(drives(run(), run())["aims"].values())
    missed = drives(run(), run(seed=7, touched=("post_3",)))
    assert missed["aims"] == {"reached": False, "contacts": False, "score": False, "time": True}
    assert missed["drives"][bench.AIMED]["failed_seeds"] == [7]
    assert sum("MISSED" in line for line in bench.report(missed)) == 3
    slow = drives(run(), run(seconds=8.0))
    assert slow["aims"] == {"reached": True, "contacts": True, "score": True, "time": False}


def test_aims_are_open_without_the_drives_they_are_about():
    found = {"drives": {"ig42 known": bench.figures([run()])}}
    found["aims"] = bench.aims(found)
    assert set(found["aims"].values()) == {None}
    assert any("1 of 1" in line for line in bench.report(found))
