from omniman_ros.core.throttle import Throttle


def test_one_passes_a_period_and_the_others_are_counted():
    throttle = Throttle(1.0)
    assert throttle.allow("a", 10.0) == 0
    assert throttle.allow("a", 10.1) is None
    assert throttle.allow("a", 10.99) is None
    assert throttle.allow("a", 11.0) == 2
    assert throttle.allow("a", 12.5) == 0
    assert throttle.counts == {"a": 5}


def test_subjects_do_not_hold_each_other_back():
    throttle = Throttle(1.0)
    assert throttle.allow("a", 0.0) == 0
    assert throttle.allow("b", 0.1) == 0
    assert throttle.allow("a", 0.2) is None
    assert throttle.counts == {"a": 2, "b": 1}


def test_a_clock_that_jumps_back_silences_nothing():
    throttle = Throttle(1.0)
    throttle.allow("a", 1000.0)
    assert throttle.allow("a", 3.0) == 0
    assert throttle.allow("a", 3.5) is None
