from omniman_ros.core.framing import CmdVelFraming

ZERO, MOTION = (0.0, 0.0, 0.0), (0.3, 0.0, 0.0)


def test_motion_is_framed_by_zeros_and_followed_by_silence():
    framing = CmdVelFraming(zeros=3)
    assert framing.next(None) is None
    assert [framing.next(MOTION) for _ in range(3)] == [ZERO, MOTION, MOTION]
    assert [framing.next(None) for _ in range(5)] == [ZERO] * 3 + [None] * 2
    assert [framing.next(MOTION) for _ in range(2)] == [ZERO, MOTION]


def test_motion_resumed_during_the_zeros_needs_no_leading_zero():
    framing = CmdVelFraming(zeros=3)
    for twist in (MOTION, MOTION, None):
        framing.next(twist)
    assert framing.next(MOTION) == MOTION
    assert [framing.next(None) for _ in range(4)] == [ZERO] * 3 + [None]
