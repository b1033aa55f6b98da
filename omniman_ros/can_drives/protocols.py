"""Drive protocols by the value of the parameter `can.protocol`: of the package, or of a user."""

from importlib import import_module

from omniman_ros.can_drives.axis import DriveAxis
from omniman_ros.can_drives.cia402.axis import Cia402Axis
from omniman_ros.can_drives.odrive import OdriveAxis
from omniman_ros.can_drives.vesc import VescAxis
from omniman_ros.core.errors import ParameterError

PROTOCOLS: dict[str, type[DriveAxis]] = {
    "cia402": Cia402Axis,
    "vesc": VescAxis,
    "odrive": OdriveAxis,
}  #: Codecs of the package by name


def drive_protocol(name: str) -> type[DriveAxis]:
    """Return the codec of a name in `PROTOCOLS`, or the class that `MODULE:CLASS` names.

    Raises:
        ParameterError: The class cannot be imported, or is no `DriveAxis` with `frames`.
    """
    if name in PROTOCOLS:
        return PROTOCOLS[name]
    module, _, attribute = name.partition(":")
    try:
        axis = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ParameterError("can.protocol", name, f"cannot be imported: {error}") from error
    if not (isinstance(axis, type) and issubclass(axis, DriveAxis)) or axis.__abstractmethods__:
        raise ParameterError("can.protocol", name, "must be a DriveAxis that defines frames()")
    return axis
