import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from omniman_ros.core.errors import InputError
from omniman_ros.recording.definitions import MessageDefinitions


@pytest.fixture
def prefix(tmp_path):
    def write(message_type, text):
        package, name = message_type.split("/")
        file = tmp_path / "share" / package / "msg" / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return tmp_path

    return write


def test_a_type_of_jazzy_is_known_with_the_types_of_its_fields():
    text, digest = MessageDefinitions().lookup("trajectory_msgs/msg/MultiDOFJointTrajectory")
    assert text.startswith("std_msgs/Header header")
    assert "MSG: geometry_msgs/Quaternion\n" in text
    assert digest.startswith("RIHS01_")


def test_a_type_of_another_package_is_read_from_its_installation(prefix):
    folder = prefix(
        "my_msgs/Outer",
        (
            "# of a grasp\nuint8 OPEN=1\nstd_msgs/Header header\nInner[<=3] parts # each\n"
            "geometry_msgs/Point[2] corners\nstring<=10 name 'none'\nfloat64[] efforts\n"
        ),
    )
    prefix("my_msgs/Inner", "bool closed\n")
    definitions = MessageDefinitions([folder / "nowhere", folder])
    text, digest = definitions.lookup("my_msgs/msg/Outer")
    for part in ("my_msgs/Inner", "geometry_msgs/Point", "builtin_interfaces/Time"):
        assert f"MSG: {part}\n" in text
    assert definitions.lookup("my_msgs/msg/Outer") == (text, digest)


@pytest.mark.parametrize(
    ("message_type", "message"),
    [
        ("nowhere_msgs/msg/X", "nowhere_msgs/msg/X is not installed here"),
        ("std_srvs/srv/Trigger", "not a message type"),
        ("../../etc/passwd", "not a message type"),
    ],
)
def test_an_unknown_type_is_refused_by_name(message_type, message):
    with pytest.raises(InputError, match=message):
        MessageDefinitions().lookup(message_type)


def test_a_type_with_a_missing_field_type_is_refused_until_that_is_installed(prefix):
    folder = prefix("my_msgs/Outer", "Inner part\n")
    definitions = MessageDefinitions([folder])
    with pytest.raises(InputError, match="my_msgs/msg/Inner"):
        definitions.lookup("my_msgs/msg/Outer")
    prefix("my_msgs/Inner", "bool closed\n")
    assert "MSG: my_msgs/Inner" in definitions.lookup("my_msgs/msg/Outer")[0]
