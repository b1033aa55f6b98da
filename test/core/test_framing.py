from omniman_ros.core.framing import Framing

ZERO, MOTION = (0.0, 0.0, 0.0), (0.3, 0.0, 0.0)


def test_a_zero_comes_before_a_motion_zeros_after_it_and_then_silence():
    framing = Framing(zeros=3)
    assert framing.next(None) is None
    assert [framing.next(MOTION) for _ in range(3)] == [ZERO, MOTION, MOTION]
    assert [framing.next(None) for _ in range(5)] == [ZERO] * 3 + [None] * 2
    assert [framing.next(MOTION) for _ in range(2)] == [ZERO, MOTION]


def test_a_motion_that_goes_on_among_the_zeros_needs_no_other():
    framing = Framing(zeros=3)
    for twist in (MOTION, MOTION, None):
        framing.next(twist)
    assert framing.next(MOTION) == MOTION
    assert [framing.next(None) for _ in range(4)] == [ZERO] * 3 + [None]
