"""An RTDE session: the dialogue, refusals, and accepted data."""

import math
import random
import struct
from dataclasses import FrozenInstanceError

import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.ur.feedback import RuntimeState
from omniman_ros.ur.rtde_packets import ProtocolError
from omniman_ros.ur.rtde_session import MAX_UNREAD_SAMPLES, RtdeSession, SessionPhase
from test.ur import peer

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


def test_dialogue_follows_the_rtde_guide():
    session = RtdeSession(24)
    assert session.phase is SessionPhase.NEW
    assert session.begin(NOW) == peer.ASK_VERSION
    for heard, said in DIALOGUE[1:]:
        assert not session.running
        assert session.feed(heard, NOW) == said
    assert session.phase is SessionPhase.RUNNING


def test_session_runs_from_the_first_usable_data():
    session = running()
    assert not session.running
    session.feed(peer.data(1.0, q=(math.nan,) * 6), NOW)
    assert not session.running
    session.feed(peer.data(1.008), NOW)
    assert session.running


def test_sample_contains_the_values_sent_by_the_controller():
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


def test_chosen_register_is_requested():
    session = RtdeSession(7)
    session.begin(NOW)
    asked = session.feed(peer.VERSION, NOW)
    assert asked.endswith(b",target_speed_fraction,output_int_register_7")


@pytest.mark.parametrize("register", [-1, 48])
def test_invalid_register_is_rejected(register):
    with pytest.raises(ParameterError, match=r"ur\.register"):
        RtdeSession(register)


# ---- split streams ----------------------------------------------------------------------------

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
def test_dialogue_split_at_any_byte_has_the_same_result(cut):
    said, samples, texts = whole([STREAM[:cut], STREAM[cut:]])
    assert said == b"".join(said for _, said in DIALOGUE)
    assert [s.timestamp for s in samples] == [1.0, 1.008]
    assert texts == ["RTDE: hello", "RTDE: mid"]


def test_single_bytes_have_the_same_result_as_one_piece():
    assert whole([STREAM]) == whole(STREAM[k : k + 1] for k in range(len(STREAM)))


def test_packet_takes_effect_only_when_complete():
    session = running(peer.data(1.0)[:-1])
    assert session.take_samples() == []
    session.feed(peer.data(1.0)[-1:], NOW + 9.0)
    assert [s.at for s in session.take_samples()] == [NOW + 9.0]


# ---- refusals ---------------------------------------------------------------------------------


def types(name, word):
    found = dict(zip(peer.NAMES.split(b","), peer.TYPES.split(b","), strict=True))
    assert name in found
    return b",".join((found | {name: word}).values())


REFUSALS = [
    (0, peer.NO_VERSION, "version 2 of the protocol is refused"),
    (1, peer.outputs(types(b"actual_q", b"NOT_FOUND"), 0), "'actual_q': NOT_FOUND"),
    (1, peer.outputs(types(b"speed_scaling", b"IN_USE"), 0), "'speed_scaling': IN_USE"),
    (
        1,
        peer.outputs(types(b"output_int_register_24", b"NOT_FOUND"), 0),
        "'output_int_register_24': NOT_FOUND; parameter ur.register chooses it",
    ),
    (
        1,
        peer.outputs(types(b"actual_q", b"NOT_FOUND").replace(b"UINT32", b"NOT_FOUND"), 0),
        "outputs actual_q, runtime_state: NOT_FOUND",
    ),
    (1, peer.outputs(types(b"actual_q", b"VECTOR3D")), "'actual_q' is VECTOR3D, must be"),
    (1, peer.outputs(types(b"robot_mode", b"DOUBLE")), "'robot_mode' is DOUBLE, must be INT32"),
    (1, peer.outputs(b"DOUBLE"), "must be 11 types of outputs, got 1"),
    (1, b"\x00\x03O", "is empty"),
    (2, peer.NO_START, "start of the data is refused"),
    (2, b"\x00\x05S\x01\x01", "must have 1 byte, got 2"),
    (3, peer.data(1.0, number=2), "recipe 2, expected 233 for 1"),
    (3, b"\x00\xeb" + peer.data(1.0)[2:-1], "data of 232 bytes"),
    (3, b"\x00\x02U", "a packet of 2 bytes"),
    (3, b"\xff\xffU", "a packet of 65535 bytes"),
]


@pytest.mark.parametrize(("step", "packet", "reason"), REFUSALS)
def test_refusal_ends_the_session_with_the_reason(step, packet, reason):
    session = RtdeSession(24)
    session.begin(NOW)
    for heard, _ in DIALOGUE[1 : step + 1]:
        session.feed(heard, NOW)
    with pytest.raises(ProtocolError, match=reason):
        session.feed(packet, NOW)
    assert session.phase is SessionPhase.ENDED
    assert not session.running
    with pytest.raises(ProtocolError, match="ended"):
        session.feed(peer.VERSION, NOW)


PACKETS = {
    "version": peer.VERSION,
    "outputs": peer.OUTPUTS,
    "start": peer.START,
    "data": peer.data(1.0),
    "pause": b"\x00\x04P\x01",
    "inputs": b"\x00\x05I\x01X",
    "unknown": b"\x00\x03\xc8",
}


@pytest.mark.parametrize("step", range(4))
@pytest.mark.parametrize("name", PACKETS)
def test_answer_out_of_order_is_an_error(step, name):
    expected = ["version", "outputs", "start", "data"][step]
    session = RtdeSession(24)
    session.begin(NOW)
    for heard, _ in DIALOGUE[1 : step + 1]:
        session.feed(heard, NOW)
    if name == expected:
        session.feed(PACKETS[name], NOW)
        return
    with pytest.raises(ProtocolError, match="is unexpected"):
        session.feed(PACKETS[name], NOW)


def test_data_before_the_session_begins_are_an_error():
    with pytest.raises(ProtocolError, match="new"):
        RtdeSession(24).feed(peer.VERSION, NOW)


def test_samples_before_an_error_remain_available():
    session = running()
    with pytest.raises(ProtocolError):
        session.feed(peer.data(1.0) + b"\x00\x00U", NOW)
    assert [s.timestamp for s in session.take_samples()] == [1.0]


def test_missing_speed_slider_is_reported_and_can_be_omitted():
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


# ---- accepted data ----------------------------------------------------------------------------

BAD = [math.nan, math.inf, -math.inf, 6.5, -6.5, 1e300]


@pytest.mark.parametrize("field", ["q", "target"])
@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("value", BAD)
def test_implausible_angle_gives_no_sample(field, joint, value):
    joints = list(peer.Q)
    joints[joint] = value
    session = running(peer.data(1.0), peer.data(1.008, **{field: joints}), peer.data(1.016))
    assert [s.timestamp for s in session.take_samples()] == [1.0, 1.016]
    assert session.counts["implausible"] == 1


@pytest.mark.parametrize(
    "change",
    [
        {"qd": (0, 0, math.nan, 0, 0, 0)},
        {"qd": (0, 25.0, 0, 0, 0, 0)},
        {"current": (0, 0, 0, 0, 0, math.inf)},
        {"current": (math.nan, 0, 0, 0, 0, 0)},
        {"scaling": math.nan},
        {"fraction": math.inf},
        {"timestamp": math.nan},
        {"timestamp": math.inf},
        {"timestamp": -math.inf},
    ],
)
def test_other_implausible_values_give_no_sample(change):
    session = running(peer.data(1.0), peer.data(**{"timestamp": 1.008} | change))
    assert [s.timestamp for s in session.take_samples()] == [1.0]
    assert session.counts["implausible"] == 1
    assert session.progress == NOW + 0.008
    session.feed(peer.data(1.016), NOW + 1.0)
    assert len(session.take_samples()) == 1


def test_both_ends_of_the_joint_range_are_accepted():
    session = running(peer.data(1.0, q=(math.tau, -math.tau, 6.33, -6.33, 0.0, -0.0)))
    assert len(session.take_samples()) == 1


def test_repeated_timestamp_gives_no_fresh_sample():
    session = running(*[peer.data(1.0)] * 5)
    assert [s.at for s in session.take_samples()] == [NOW + 0.008]
    assert session.progress == NOW + 0.008
    assert session.counts == {"repeated": 4, "backward": 0, "implausible": 0, "skipped": 0}


def test_backward_timestamp_gives_no_fresh_sample_until_past_the_latest():
    times = (5.0, 4.992, 3.5, 5.0, 5.008, 5.004, 5.016)
    session = running(*map(peer.data, times))
    assert [s.timestamp for s in session.take_samples()] == [5.0, 5.008, 5.016]
    assert session.counts == {"repeated": 1, "backward": 3, "implausible": 0, "skipped": 0}


@pytest.mark.parametrize(("step", "skipped"), [(0.008, 0), (0.0119, 0), (0.0121, 1), (9.0, 1)])
def test_gap_is_counted_and_later_data_are_used(step, skipped):
    session = running(peer.data(1.0), peer.data(1.0 + step))
    assert len(session.take_samples()) == 2
    assert session.counts["skipped"] == skipped


def test_restarted_controller_needs_a_new_session():
    session = running(peer.data(500.0))
    with pytest.raises(ProtocolError, match=r"went back by 499\.000 s"):
        session.feed(peer.data(1.0), NOW)
    assert len(running(peer.data(1.0)).take_samples()) == 1


def test_texts_and_unusable_data_are_no_progress():
    session = running(peer.data(1.0))
    session.feed(peer.text(b"x") + peer.data(1.0) + peer.data(0.9), NOW + 5.0)
    session.feed(peer.data(1.1, q=(math.nan,) * 6), NOW + 6.0)
    assert session.progress == NOW + 0.008


@pytest.mark.parametrize(
    ("scaling", "fraction", "speed"),
    [
        (1.0, 1.0, 1.0),
        (0.5, 0.5, 0.25),
        (0.0, 1.0, 0.0),
        (1.2, 1.0, 1.0),
        (-0.1, 1.0, 0.0),
        (1e300, 1e300, 1.0),
    ],
)
def test_speed_is_slider_times_limiter_clipped_to_0_and_1(scaling, fraction, speed):
    session = running(peer.data(1.0, scaling=scaling, fraction=fraction))
    assert [s.speed_scaling for s in session.take_samples()] == [speed]


@pytest.mark.parametrize("state", RuntimeState)
def test_speed_is_zero_while_the_program_is_paused_or_resumes(state):
    session = running(peer.data(1.0, modes=(7, 1, state), scaling=0.5))
    stands = state in (RuntimeState.PAUSED, RuntimeState.RESUMING)
    assert [s.speed_scaling for s in session.take_samples()] == [0.0 if stands else 0.5]


def test_unread_samples_and_texts_are_bounded():
    session = running(
        *(peer.data(0.008 * k) + peer.text(b"x") for k in range(MAX_UNREAD_SAMPLES + 10))
    )
    samples = session.take_samples()
    assert len(samples) == len(session.take_texts()) == MAX_UNREAD_SAMPLES
    assert samples[-1].timestamp == 0.008 * (MAX_UNREAD_SAMPLES + 9)


# ---- noise ------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("count", [10_000, pytest.param(100_000, marks=pytest.mark.exhaustive)])
def test_mutated_packets_raise_protocol_errors_or_are_dropped_or_are_plausible(count):
    chance = random.Random(4)
    session, errors, used = running(), 0, 0
    base = bytearray(peer.data(0.0))
    for k in range(count):
        packet = bytearray(base)
        struct.pack_into(">d", packet, 4, 0.008 * k)
        for _ in range(chance.choice((0, 1, 1, 2, 8))):
            # mostly values: a wrong header ends the session at once
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
    assert errors > count // 1000
    assert used > 3 * count // 10


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
