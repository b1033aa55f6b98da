import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from omniman_ros.bag.definitions import Definitions
from omniman_ros.core.errors import InputError


@pytest.fixture
def prefix(tmp_path):
    def write(kind, text):
        package, name = kind.split("/")
        file = tmp_path / "share" / package / "msg" / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return tmp_path

    return write


def test_a_type_of_jazzy_is_known_with_all_that_is_in_it():
    text, digest = Definitions().of("trajectory_msgs/msg/MultiDOFJointTrajectory")
    assert text.startswith("std_msgs/Header header")
    assert "MSG: geometry_msgs/Quaternion\n" in text
    assert digest.startswith("RIHS01_")


def test_a_type_of_another_package_is_read_from_where_it_is_installed(prefix):
    folder = prefix("my_msgs/Outer", (
        "# of a grasp\nuint8 OPEN=1\nstd_msgs/Header header\nInner[<=3] parts # each\n"
        "geometry_msgs/Point[2] corners\nstring<=10 name 'none'\nfloat64[] efforts\n"
    ))  # fmt: skip
    prefix("my_msgs/Inner", "bool closed\n")
    definitions = Definitions([folder / "nowhere", folder])
    text, digest = definitions.of("my_msgs/msg/Outer")
    for part in ("my_msgs/Inner", "geometry_msgs/Point", "builtin_interfaces/Time"):
        assert f"MSG: {part}\n" in text
    assert definitions.of("my_msgs/msg/Outer") == (text, digest)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("nowhere_msgs/msg/X", "no definition of nowhere_msgs/msg/X here"),
        ("std_srvs/srv/Trigger", "no message type"),
        ("../../etc/passwd", "no message type"),
    ],
)
def test_what_is_not_known_is_refused_by_name(kind, message):
    with pytest.raises(InputError, match=message):
        Definitions().of(kind)


def test_a_type_with_a_part_that_is_missing_is_refused_and_can_be_had_later(prefix):
    folder = prefix("my_msgs/Outer", "Inner part\n")
    definitions = Definitions([folder])
    with pytest.raises(InputError, match="my_msgs/msg/Inner"):
        definitions.of("my_msgs/msg/Outer")
    prefix("my_msgs/Inner", "bool closed\n")
    assert "MSG: my_msgs/Inner" in definitions.of("my_msgs/msg/Outer")[0]
