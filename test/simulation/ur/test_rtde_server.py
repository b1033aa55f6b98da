"""The RTDE server, one client at a time, without sockets."""

import struct

import pytest

from omniman_ros.simulation.ur.port_clients import PackageQueue
from omniman_ros.simulation.ur.rtde_server import RtdeError, RtdeFaults, RtdeServerSession

VERSION_2 = bytes.fromhex("0005 56 0002")
START, PAUSE = bytes.fromhex("0003 53"), bytes.fromhex("0003 50")
# Universal_Robots_Client_Library, tests/test_rtde_parser.cpp.
ACCEPTED, STARTED, PAUSED = (bytes.fromhex(f"0004 {kind} 01") for kind in ("56", "53", "50"))
TIME, FRACTION = 16412.20574, 1.0
DATA = bytes.fromhex("0014 55 01 40d0070d2f1a9fbe 3ff0000000000000")


class Variables:
    def __init__(self):
        self.values = {
            "timestamp": struct.unpack(">d", DATA[4:12])[0],
            "target_speed_fraction": 1.0,
        }
        self.written = []

    def output(self, name):
        return self.values[name]

    def write_inputs(self, values):
        self.written.append(values)


def package(letter, payload):
    return struct.pack(">HB", 3 + len(payload), ord(letter)) + payload


def outputs(names, frequency=125.0):
    return package("O", struct.pack(">d", frequency) + names.encode())


@pytest.fixture
def variables():
    return Variables()


@pytest.fixture
def session(variables):
    made = RtdeServerSession(variables, {})
    assert made.receive(VERSION_2) == ACCEPTED
    return made


def test_answers_have_the_bytes_of_public_logs(session):
    assert session.receive(outputs("timestamp,actual_q"))[3:] == b"\x01DOUBLE,VECTOR6D"
    # ibid., control_package_setup_inputs.
    assert session.receive(package("I", b"speed_slider_mask,speed_slider_fraction")) == (
        bytes.fromhex("0011 49 01") + b"UINT32,DOUBLE"
    )
    assert session.receive(START) == STARTED
    assert session.receive(PAUSE) == PAUSED
    # ibid., get_urcontrol_version, with the version of a CB3 controller.
    assert session.receive(bytes.fromhex("0003 76")) == bytes.fromhex(
        "0013 76 00000003 0000000f 00000008 00019f63"
    )


def test_data_packages_have_the_bytes_of_public_logs(session):
    session.receive(outputs("timestamp,target_speed_fraction"))
    assert session.data() == b""
    session.receive(START)
    assert session.data() == DATA
    session.receive(PAUSE)
    assert session.data() == b""


def test_joint_angles_have_the_bytes_of_public_logs(session, variables):
    # ibid., tests/test_rtde_data_package.cpp, parse_pkg_protocolv2.
    payload = bytes.fromhex(
        "01 40d0758c49ba5e35 bff99c77d110b460 bffba233d110b460 c0019fbe68885a30"
        "bfe9db22a22168c0 3ff98587a0000000 bf9fbe74442d1800"
    )
    values = struct.unpack(">7d", payload[1:])
    variables.values |= {"timestamp": values[0], "actual_q": values[1:]}
    assert values[1:] == pytest.approx(
        (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031), abs=1e-4
    )
    session.receive(outputs("timestamp,actual_q") + START)
    assert session.data() == bytes.fromhex("003c 55") + payload


def test_inputs_are_read_from_the_bytes_of_public_logs(session, variables):
    session.receive(package("I", b"speed_slider_mask"))
    # ibid., serialize_pkg.
    data = bytes.fromhex("0008 55 01 00000001")
    session.receive(data)
    assert variables.written == []  # not started
    session.receive(START + data)
    assert variables.written == [{"speed_slider_mask": 1}]


def test_bytes_may_arrive_in_any_pieces(variables):
    stream = VERSION_2 + outputs("timestamp") + package("I", b"input_int_register_0") + START
    whole = RtdeServerSession(variables, {}).receive(stream)
    for size in (1, 2, 3, 7):
        session = RtdeServerSession(variables, {})
        pieces = (session.receive(stream[k : k + size]) for k in range(0, len(stream), size))
        assert b"".join(pieces) == whole


def test_names_may_end_with_a_comma(session):
    assert session.receive(outputs("timestamp,"))[3:] == b"\x01DOUBLE"


def test_unknown_output_is_not_found_and_no_data_start(session):
    answer = session.receive(outputs("timestamp,nonsense"))
    assert answer[3:] == b"\x00DOUBLE,NOT_FOUND"
    assert session.receive(START) == bytes.fromhex("0004 53 00")
    assert session.data() == b""


def test_output_made_missing_by_a_fault_is_not_found(session):
    session.faults = RtdeFaults(not_found=("actual_q",))
    assert session.receive(outputs("actual_q"))[3:] == b"\x00NOT_FOUND"


def test_input_has_one_writer_until_the_writer_disconnects(variables):
    owners = {}
    first, second = RtdeServerSession(variables, owners), RtdeServerSession(variables, owners)
    setup = package("I", b"input_int_register_3,nonsense")
    for each in (first, second):
        each.receive(VERSION_2)
    assert first.receive(setup)[3:] == b"\x00INT32,NOT_FOUND"
    setup = package("I", b"input_int_register_3")
    assert first.receive(setup)[3:] == b"\x01INT32"
    assert first.receive(setup)[3:] == b"\x02INT32"  # the same client, in another recipe
    assert second.receive(setup)[3:] == b"\x00IN_USE"
    first.close()
    assert second.receive(setup)[3:] == b"\x01INT32"
    second.faults = RtdeFaults(in_use=("input_int_register_3",))
    assert second.receive(setup)[3:] == b"\x00IN_USE"


@pytest.mark.parametrize("version", [0, 1, 3])
def test_other_version_is_refused_and_further_data_are_an_error(variables, version):
    session = RtdeServerSession(variables, {})
    assert session.receive(package("V", struct.pack(">H", version)))[3:] == b"\0"
    with pytest.raises(RtdeError, match="version 1"):
        session.receive(START)


def test_version_2_is_refused_under_a_fault(variables):
    session = RtdeServerSession(variables, {})
    session.faults = RtdeFaults(refuse_version=True)
    assert session.receive(VERSION_2)[3:] == b"\0"


@pytest.mark.parametrize(
    "data",
    [
        b"\x00\x02S",
        b"\x00\x03Z",
        b"\x00\x04V\x00",
        b"\x00\x03U",
        package("U", b"\x09"),
        package("U", b"\x01\0\0\0"),
        package("U", b"\x01\0\0\0\0\0"),
        package("O", b"\0" * 7),
        package("I", b"x" * 2049),
    ],
)
def test_invalid_package_ends_the_connection(session, data):
    session.receive(package("I", b"speed_slider_mask") + START)
    with pytest.raises(RtdeError):
        session.receive(data)


@pytest.mark.parametrize(
    ("frequency", "sent"),
    [
        (125, 125),
        (500, 125),
        (0, 125),
        (62.5, 63),
        (50, 50),
        (10, 10),
        (1, 1),
        (float("nan"), 125),
    ],
)
def test_data_arrive_at_the_requested_rate(session, frequency, sent):
    session.receive(outputs("timestamp", frequency) + START)
    assert sum(bool(session.data()) for _ in range(125)) == pytest.approx(sent, abs=1)


def send(queue, packages):
    pieces = []
    for each in packages:
        queue.put(each)
        pieces.append(queue.take())
    return pieces


@pytest.mark.parametrize("cut", range(1, 4))
def test_split_package_is_complete_a_cycle_later(cut):
    queue = PackageQueue()
    queue.split_at = cut
    pieces = send(queue, [b"abc", b"def", b"", b""])
    assert pieces == [b"abc"[:cut], b"abc"[cut:] + b"def"[:cut], b"def"[cut:], b""]


def test_packages_can_be_sent_together():
    queue = PackageQueue()
    queue.coalesce = 3
    assert send(queue, [b"a", b"b", b"c", b"d"]) == [b"", b"", b"abc", b""]
    queue.coalesce = 1
    assert send(queue, [b"e"]) == [b"de"]
