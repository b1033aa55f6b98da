from omniman_ros.core.throttle import Throttle


def test_one_message_per_period_passes_and_the_others_are_counted():
    throttle = Throttle(1.0)
    assert throttle.allow("a", 10.0) == 0
    assert throttle.allow("a", 10.1) is None
    assert throttle.allow("a", 10.99) is None
    assert throttle.allow("a", 11.0) == 2
    assert throttle.allow("a", 12.5) == 0
    assert throttle.counts == {"a": 5}


def test_subjects_are_throttled_independently():
    throttle = Throttle(1.0)
    assert throttle.allow("a", 0.0) == 0
    assert throttle.allow("b", 0.1) == 0
    assert throttle.allow("a", 0.2) is None
    assert throttle.counts == {"a": 2, "b": 1}


def test_backward_clock_jump_suppresses_no_message():
    throttle = Throttle(1.0)
    throttle.allow("a", 1000.0)
    assert throttle.allow("a", 3.0) == 0
    assert throttle.allow("a", 3.5) is None
