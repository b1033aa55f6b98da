"""The streamer's restart, replacement and delays, with a simulated link."""

import numpy as np
import pytest

from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import PERIOD
from omniman_ros.ur.program_link import ProgramState
from omniman_ros.ur.streaming_messages import StreamingPhase
from test.ur.test_streaming_supervisor import HOME, Rig, moving, settle


@pytest.fixture
def rig():
    return Rig().streaming()


def test_stop_reason_is_the_cause_and_not_the_later_program_state(rig):
    moving(rig)
    rig.hear(safety_mode=3, runtime_state=3)
    assert rig.streamer.stop_reason == "safety mode: protective stop"


def test_start_clears_an_earlier_stop(rig):
    rig.streamer.stop("by hand")
    settle(rig)
    rig.streamer.finish()
    rig.streamer.start(rig.now)
    assert rig.streamer.phase is StreamingPhase.STARTING
    assert rig.streamer.stop_reason == ""


def test_finish_clears_the_reason_of_a_failed_start():
    rig = Rig()
    rig.hear(robot_mode=3)
    rig.streamer.start(rig.now)
    assert rig.streamer.failure
    rig.streamer.finish()
    assert rig.streamer.failure == ""


def test_replacement_streamer_starts_with_the_reset_and_not_before():
    rig = Rig()
    rig.streamer.stop("the one before has ended")
    rig.streamer.resume()
    rig.cycle(5)
    assert rig.streamer.phase is StreamingPhase.IDLE and not rig.link.texts
    rig.streamer.reset(rig.now)
    assert rig.streamer.phase is StreamingPhase.STARTING


def test_replacement_streamer_stops_if_its_program_does_not_start():
    rig = Rig()
    rig.streamer.resume()
    rig.streamer.reset(rig.now)
    rig.link.program, rig.link.program_loss_reason = ProgramState.LOST, "no call"
    rig.cycle()
    assert rig.streamer.stop_reason == "no call"
    assert rig.streamer.failure == ""


def test_pause_brings_the_arm_to_rest_and_the_next_preview_drives_again(rig):
    moving(rig)
    rig.streamer.pause("a test")
    rig.cycle(60)
    assert rig.speeds[-1] == 0.0
    assert np.abs(np.diff(rig.speeds)).max() <= 5.0 * PERIOD * 1.001
    assert rig.streamer.phase is StreamingPhase.STREAMING
    assert rig.streamer.take_refusals() == ("the arm is brought to rest: a test",)
    rig.streamer.pause("a test")
    assert not rig.streamer.take_refusals(), "the arm is at rest"
    rig.preview()
    rig.cycle(40)
    assert rig.speeds[-1] > 0.2


def steady(rig, start, seconds, speed=1.5):
    """Return a preview of a constant-speed motion that began smoothly at time `start`."""
    times = rig.now + np.linspace(0.0, seconds, 20)
    since, rise = times - start, 0.6
    gathered = np.minimum(since, rise)
    way = speed * (gathered**3 / rise**2 - gathered**4 / (2.0 * rise**3))
    way += speed * np.maximum(since - rise, 0.0)
    rate = speed * (3.0 * (gathered / rise) ** 2 - 2.0 * (gathered / rise) ** 3)
    signs = np.array([1.0, 0.0, -1.0, 0.0, 0.0, 1.0])
    return JointPreview(
        times, np.array(HOME) + way[:, None] * signs, rate[:, None] * np.abs(signs) * signs
    )


@pytest.mark.parametrize("copies", [1, 2, 3])
def test_repeated_preview_does_not_make_its_source_silent(rig, copies):
    # 240 ms of preview are less than it takes to brake from 1.5 rad/s within 5 rad/s^2.
    start, slowest = rig.now, np.inf
    for k in range(40):
        preview = steady(rig, start, 0.24)
        for _ in range(copies):
            rig.streamer.follow(preview, rig.now)
        rig.cycle(4)
        if k > 25:
            slowest = min(slowest, rig.speeds[-4:].min())
    assert not rig.streamer.take_refusals()
    assert slowest == pytest.approx(1.5, rel=0.01)


def test_previews_in_pairs_do_not_make_their_source_silent(rig):
    start, slowest = rig.now, np.inf
    for k in range(24):
        rig.cycle(4)
        held_up = steady(rig, start, 0.24)
        rig.cycle(3)
        rig.streamer.follow(held_up, rig.now)
        rig.cycle()
        rig.streamer.follow(steady(rig, start, 0.24), rig.now)
        if k > 14:
            slowest = min(slowest, rig.speeds[-8:].min())
    assert not rig.streamer.take_refusals()
    assert slowest == pytest.approx(1.5, rel=0.01)


def test_source_that_only_repeats_one_preview_counts_as_silent(rig):
    start = rig.now
    for _ in range(30):
        rig.streamer.follow(steady(rig, start, 0.6), rig.now)
        rig.cycle(4)
    last = steady(rig, start, 0.6)
    since = rig.now
    while rig.speeds[-1] > 0.0:
        rig.streamer.follow(last, rig.now)
        rig.cycle(2)
        assert rig.now - since < 0.75, "braking begins while the preview lasts"
    assert rig.streamer.phase is StreamingPhase.STREAMING
