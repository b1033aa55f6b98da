"""The codec that the parameter `can.protocol` names."""

import pytest

from omniman_ros.can_drives.odrive import OdriveAxis
from omniman_ros.can_drives.protocols import drive_protocol
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.robot_model import load_robot
from test.can_drives.scripted import PROTOCOL, ScriptedAxis


def test_a_name_is_a_codec_of_the_package_and_a_module_with_a_class_one_of_the_user():
    assert drive_protocol("odrive") is OdriveAxis
    assert drive_protocol(PROTOCOL) is ScriptedAxis


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("modbus", "cannot be imported"),
        ("no_such_module:Axis", "cannot be imported: No module named"),
        (":Axis", "cannot be imported"),
        ("test.can_drives.scripted:NoSuchAxis", "cannot be imported"),
        ("test.can_drives.scripted:ScriptedNetwork", "must be a DriveAxis"),
        ("test.can_drives.scripted:report", "must be a DriveAxis"),
        ("omniman_ros.can_drives.axis:DriveAxis", "must be a DriveAxis that defines frames"),
    ],
)
def test_a_protocol_that_is_no_codec_is_refused(name, reason):
    with pytest.raises(ParameterError, match=reason) as info:
        drive_protocol(name)
    assert info.value.name == "can.protocol"


def test_an_installation_names_a_protocol_or_a_module_with_a_class():
    platform = load_robot().platform
    CanParameters(nodes=(1, 2, 3, 4), protocol="any_module:AnyAxis").check(platform)
    with pytest.raises(ParameterError, match="cia402, vesc, odrive, or MODULE:CLASS"):
        CanParameters(nodes=(1, 2, 3, 4), protocol="modbus").check(platform)
