"""An RTDE session: the dialogue, what is refused, and which data count."""

import math
import random
import struct
from dataclasses import FrozenInstanceError

import pytest

from omniman_ros.arm.errors import ProtocolError
from omniman_ros.arm.feedback import RuntimeState
from omniman_ros.arm.rtde_session import KEPT, Phase, RtdeSession
from omniman_ros.core.errors import ParameterError
from test.arm import peer

NOW = 50.0
DIALOGUE = [
    (b"", peer.ASK_VERSION),
    (peer.VERSION, peer.ASK_OUTPUTS),
    (peer.OUTPUTS, peer.ASK_START),
    (peer.START, b""),
]
GREETING = b"".join(heard for heard, _ in DIALOGUE)


def running(*packets):
    session = RtdeSession(24)
    session.begin(NOW)
    session.feed(GREETING, NOW)
    for k, packet in enumerate(packets):
        assert session.feed(packet, NOW + 0.008 * (k + 1)) == b""
    return session


def test_the_dialogue_is_that_of_the_guide():
    session = RtdeSession(24)
    assert session.phase is Phase.NEW
    assert session.begin(NOW) == peer.ASK_VERSION
    for heard, said in DIALOGUE[1:]:
        assert not session.running
        assert session.feed(heard, NOW) == said
    assert session.phase is Phase.RUNNING


def test_it_runs_with_the_first_usable_data():
    session = running()
    assert not session.running
    session.feed(peer.data(1.0, q=(math.nan,) * 6), NOW)
    assert not session.running
    session.feed(peer.data(1.008), NOW)
    assert session.running


def test_a_sample_holds_what_the_controller_sent():
    session = running(
        peer.data(12.5, modes=(7, 3, 4 - 2), scaling=0.5, fraction=0.5, read=2**31 - 1)
    )
    (sample,) = session.take_samples()
    assert sample.at == NOW + 0.008
    assert sample.timestamp == 12.5
    assert sample.position == peer.Q
    assert sample.velocity == peer.QD
    assert sample.target == peer.TARGET
    assert sample.current == peer.CURRENT
    assert (sample.robot_mode, sample.safety_mode, sample.runtime_state) == (7, 3, 2)
    assert sample.speed_scaling == 0.25
    assert sample.read == 2**31 - 1
    assert session.take_samples() == []
    with pytest.raises(FrozenInstanceError):
        sample.at = 0.0


def test_the_register_is_the_one_that_was_chosen():
    session = RtdeSession(7)
    session.begin(NOW)
    asked = session.feed(peer.VERSION, NOW)
    assert asked.endswith(b",target_speed_fraction,output_int_register_7")


@pytest.mark.parametrize("register", [-1, 48])
def test_a_register_that_is_none_is_refused(register):
    with pytest.raises(ParameterError, match="ur.register"):
        RtdeSession(register)


# ---- cut and joined -----------------------------------------------------------------------------

STREAM = (
    peer.text(b"hello") + GREETING + peer.data(1.0) + peer.text(b"mid") + peer.data(1.008, read=1)
)


def whole(parts):
    session, said = RtdeSession(24), b""
    said += session.begin(NOW)
    for part in parts:
        said += session.feed(part, NOW)
    return said, session.take_samples(), session.take_texts()


@pytest.mark.parametrize("cut", range(len(STREAM) + 1))
def test_a_dialogue_cut_at_any_byte_is_the_same(cut):
    said, samples, texts = whole([STREAM[:cut], STREAM[cut:]])
    assert said == b"".join(said for _, said in DIALOGUE)
    assert [s.timestamp for s in samples] == [1.0, 1.008]
    assert texts == ["RTDE: hello", "RTDE: mid"]


def test_single_bytes_give_the_same_as_all_at_once():
    assert whole([STREAM]) == whole(STREAM[k : k + 1] for k in range(len(STREAM)))


def test_a_packet_counts_when_it_is_whole_and_not_before():
    session = running(peer.data(1.0)[:-1])
    assert session.take_samples() == []
    session.feed(peer.data(1.0)[-1:], NOW + 9.0)
    assert [s.at for s in session.take_samples()] == [NOW + 9.0]


# ---- refusals -----------------------------------------------------------------------------------


def types(name, word):
    found = dict(zip(peer.NAMES.split(b","), peer.TYPES.split(b","), strict=True))
    assert name in found
    return b",".join((found | {name: word}).values())


REFUSALS = [
    (0, peer.NO_VERSION, "version 2 of the protocol is refused"),
    (1, peer.outputs(types(b"actual_q", b"NOT_FOUND"), 0), "'actual_q': NOT_FOUND"),
    (1, peer.outputs(types(b"speed_scaling", b"IN_USE"), 0), "'speed_scaling': IN_USE"),
    (
        1, peer.outputs(types(b"output_int_register_24", b"NOT_FOUND"), 0),
        "'output_int_register_24': NOT_FOUND; parameter ur.register chooses it",
    ),
    (
        1,
        peer.outputs(types(b"actual_q", b"NOT_FOUND").replace(b"UINT32", b"NOT_FOUND"), 0),
        "outputs actual_q, runtime_state: NOT_FOUND",
    ),
    (1, peer.outputs(types(b"actual_q", b"VECTOR3D")), "'actual_q' is VECTOR3D, expected"),
    (1, peer.outputs(types(b"robot_mode", b"DOUBLE")), "'robot_mode' is DOUBLE, expected INT32"),
    (1, peer.outputs(b"DOUBLE"), "1 types for 11 outputs"),
    (1, b"\x00\x03O", "empty answer"),
    (2, peer.NO_START, "start of the data is refused"),
    (2, b"\x00\x05S\x01\x01", "an answer of 2 bytes"),
    (3, peer.data(1.0, number=2), "recipe 2, expected 233 for 1"),
    (3, b"\x00\xeb" + peer.data(1.0)[2:-1], "data of 232 bytes"),
    (3, b"\x00\x02U", "a packet of 2 bytes"),
    (3, b"\xff\xffU", "a packet of 65535 bytes"),
]  # fmt: skip


@pytest.mark.parametrize(("step", "packet", "reason"), REFUSALS)
def test_a_refusal_ends_the_session_and_says_why(step, packet, reason):
    session = RtdeSession(24)
    session.begin(NOW)
    for heard, _ in DIALOGUE[1 : step + 1]:
        session.feed(heard, NOW)
    with pytest.raises(ProtocolError, match=reason):
        session.feed(packet, NOW)
    assert session.phase is Phase.ENDED
    assert not session.running
    with pytest.raises(ProtocolError, match="ended"):
        session.feed(peer.VERSION, NOW)


PACKETS = {
    "version": peer.VERSION, "outputs": peer.OUTPUTS, "start": peer.START,
    "data": peer.data(1.0), "pause": b"\x00\x04P\x01", "inputs": b"\x00\x05I\x01X",
    "unknown": b"\x00\x03\xc8",
}  # fmt: skip


@pytest.mark.parametrize("step", range(4))
@pytest.mark.parametrize("name", PACKETS)
def test_an_answer_out_of_turn_is_an_error(step, name):
    expected = ["version", "outputs", "start", "data"][step]
    session = RtdeSession(24)
    session.begin(NOW)
    for heard, _ in DIALOGUE[1 : step + 1]:
        session.feed(heard, NOW)
    if name == expected:
        session.feed(PACKETS[name], NOW)
        return
    with pytest.raises(ProtocolError, match="out of turn"):
        session.feed(PACKETS[name], NOW)


def test_nothing_is_heard_before_it_begins():
    with pytest.raises(ProtocolError, match="new"):
        RtdeSession(24).feed(peer.VERSION, NOW)


def test_what_was_good_before_an_error_can_be_taken():
    session = running()
    with pytest.raises(ProtocolError):
        session.feed(peer.data(1.0) + b"\x00\x00U", NOW)
    assert [s.timestamp for s in session.take_samples()] == [1.0]


def test_a_controller_without_a_speed_slider_is_named_and_can_be_read_without():
    session = RtdeSession(24)
    session.begin(NOW)
    session.feed(peer.VERSION, NOW)
    with pytest.raises(ProtocolError, match="target_speed_fraction': NOT_FOUND"):
        session.feed(peer.outputs(types(b"target_speed_fraction", b"NOT_FOUND"), 0), NOW)
    assert session.missing == {"target_speed_fraction"}
    session = RtdeSession(24, slider=False)
    session.begin(NOW)
    assert b"target_speed_fraction" not in session.feed(peer.VERSION, NOW)
    fewer = peer.TYPES.replace(b"DOUBLE,DOUBLE", b"DOUBLE")
    session.feed(peer.outputs(fewer) + peer.START, NOW)
    old = peer.data(1.0, scaling=0.5)
    session.feed(b"\x00\xe4" + old[2:-12] + old[-4:], NOW)
    assert [s.speed_scaling for s in session.take_samples()] == [0.5]


# ---- which data count ---------------------------------------------------------------------------

BAD = [math.nan, math.inf, -math.inf, 6.5, -6.5, 1e300]


@pytest.mark.parametrize("field", ["q", "target"])
@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("value", BAD)
def test_an_angle_that_cannot_be_is_never_a_sample(field, joint, value):
    joints = list(peer.Q)
    joints[joint] = value
    session = running(peer.data(1.0), peer.data(1.008, **{field: joints}), peer.data(1.016))
    assert [s.timestamp for s in session.take_samples()] == [1.0, 1.016]
    assert session.counts["implausible"] == 1


@pytest.mark.parametrize(
    "change",
    [
        {"qd": (0, 0, math.nan, 0, 0, 0)}, {"qd": (0, 25.0, 0, 0, 0, 0)},
        {"current": (0, 0, 0, 0, 0, math.inf)}, {"current": (math.nan, 0, 0, 0, 0, 0)},
        {"scaling": math.nan}, {"fraction": math.inf}, {"timestamp": math.nan},
        {"timestamp": math.inf}, {"timestamp": -math.inf},
    ],
)  # fmt: skip
def test_other_values_that_cannot_be_make_no_sample(change):
    session = running(peer.data(1.0), peer.data(**{"timestamp": 1.008} | change))
    assert [s.timestamp for s in session.take_samples()] == [1.0]
    assert session.counts["implausible"] == 1
    assert session.progress == NOW + 0.008
    session.feed(peer.data(1.016), NOW + 1.0)
    assert len(session.take_samples()) == 1


def test_both_ends_of_the_joints_range_are_believed():
    session = running(peer.data(1.0, q=(math.tau, -math.tau, 6.33, -6.33, 0.0, -0.0)))
    assert len(session.take_samples()) == 1


def test_a_repeated_timestamp_makes_nothing_fresh():
    session = running(*[peer.data(1.0)] * 5)
    assert [s.at for s in session.take_samples()] == [NOW + 0.008]
    assert session.progress == NOW + 0.008
    assert session.counts == {"repeated": 4, "backward": 0, "implausible": 0, "skipped": 0}


def test_a_timestamp_that_goes_back_makes_nothing_fresh_until_it_is_ahead_again():
    times = (5.0, 4.992, 3.5, 5.0, 5.008, 5.004, 5.016)
    session = running(*map(peer.data, times))
    assert [s.timestamp for s in session.take_samples()] == [5.0, 5.008, 5.016]
    assert session.counts == {"repeated": 1, "backward": 3, "implausible": 0, "skipped": 0}


@pytest.mark.parametrize(("step", "skipped"), [(0.008, 0), (0.0119, 0), (0.0121, 1), (9.0, 1)])
def test_a_gap_is_counted_and_the_data_after_it_used(step, skipped):
    session = running(peer.data(1.0), peer.data(1.0 + step))
    assert len(session.take_samples()) == 2
    assert session.counts["skipped"] == skipped


def test_a_controller_that_was_started_anew_needs_a_new_session():
    session = running(peer.data(500.0))
    with pytest.raises(ProtocolError, match="went back by 499.000 s"):
        session.feed(peer.data(1.0), NOW)
    assert len(running(peer.data(1.0)).take_samples()) == 1


def test_texts_and_useless_data_are_no_progress():
    session = running(peer.data(1.0))
    session.feed(peer.text(b"x") + peer.data(1.0) + peer.data(0.9), NOW + 5.0)
    session.feed(peer.data(1.1, q=(math.nan,) * 6), NOW + 6.0)
    assert session.progress == NOW + 0.008


@pytest.mark.parametrize(
    ("scaling", "fraction", "speed"),
    [(1.0, 1.0, 1.0), (0.5, 0.5, 0.25), (0.0, 1.0, 0.0), (1.2, 1.0, 1.0), (-0.1, 1.0, 0.0),
     (1e300, 1e300, 1.0)],
)  # fmt: skip
def test_speed_is_slider_times_limiter_within_0_and_1(scaling, fraction, speed):
    session = running(peer.data(1.0, scaling=scaling, fraction=fraction))
    assert [s.speed_scaling for s in session.take_samples()] == [speed]


@pytest.mark.parametrize("state", RuntimeState)
def test_speed_is_nothing_while_the_program_is_paused_or_resumes(state):
    session = running(peer.data(1.0, modes=(7, 1, state), scaling=0.5))
    stands = state in (RuntimeState.PAUSED, RuntimeState.RESUMING)
    assert [s.speed_scaling for s in session.take_samples()] == [0.0 if stands else 0.5]


def test_what_nobody_takes_does_not_grow_for_ever():
    session = running(*(peer.data(0.008 * k) + peer.text(b"x") for k in range(KEPT + 10)))
    samples = session.take_samples()
    assert len(samples) == len(session.take_texts()) == KEPT
    assert samples[-1].timestamp == 0.008 * (KEPT + 9)


# ---- noise --------------------------------------------------------------------------------------


def check(samples):
    for s in samples:
        assert all(abs(x) <= 6.4 for x in (*s.position, *s.target))
        assert all(abs(x) <= 20 for x in s.velocity)
        assert all(math.isfinite(x) for x in (*s.current, s.timestamp))
        assert 0.0 <= s.speed_scaling <= 1.0


def test_random_bytes_raise_protocol_errors_and_nothing_else():
    chance = random.Random(3)
    errors = 0
    for _ in range(3000):
        session = RtdeSession(24)
        session.begin(NOW)
        with_greeting = chance.random() < 0.5
        try:
            if with_greeting:
                session.feed(GREETING, NOW)
            for _ in range(4):
                session.feed(chance.randbytes(chance.randrange(300)), NOW)
        except ProtocolError:
            errors += 1
        check(session.take_samples())
    assert errors > 2500


def test_mutated_packets_raise_protocol_errors_or_are_dropped_or_are_plausible():
    chance = random.Random(4)
    session, errors, used = running(), 0, 0
    base = bytearray(peer.data(0.0))
    for k in range(100_000):
        packet = bytearray(base)
        struct.pack_into(">d", packet, 4, 0.008 * k)
        for _ in range(chance.choice((0, 1, 1, 2, 8))):
            # mostly values: a header that is wrong ends the session and the lesson
            at = chance.randrange(4 if chance.random() < 0.97 else 0, len(packet))
            packet[at] = chance.choice((0x00, 0x7F, 0xFF, 0xF0, chance.randrange(256)))
        try:
            session.feed(bytes(packet), NOW)
        except ProtocolError:
            errors += 1
            session = running()
        samples = session.take_samples()
        check(samples)
        used += len(samples)
    assert errors > 100
    assert used > 30_000


def test_mutated_dialogues_raise_protocol_errors_and_nothing_else():
    chance = random.Random(5)
    errors = 0
    for _ in range(3000):
        stream = bytearray(STREAM)
        for _ in range(chance.randrange(1, 4)):
            at = chance.randrange(len(GREETING) + 20)
            stream[at] = chance.randrange(256)
        session = RtdeSession(24)
        session.begin(NOW)
        try:
            session.feed(bytes(stream), NOW)
        except ProtocolError:
            errors += 1
        check(session.take_samples())
    assert errors > 1500
