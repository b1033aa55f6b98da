"""Faults of the simulated controller, which parameters switch on and off."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class UrFaultParameters(Validated):
    """Faults to test a client against. All can be changed while the controller runs.

    A fault that occurs once does so each time its parameter becomes true.
    """

    protective_stop: bool = parameter(False, "Once: trigger a protective stop.")
    emergency_stop: bool = parameter(False, "The emergency stop button is pressed.")
    pause_program: bool = parameter(False, "Once: pause the program at the pendant.")
    freeze_program: bool = parameter(False, "The program stands still; everything else continues.")
    freeze_rtde: bool = parameter(
        False, "RTDE neither reads nor sends; its connections stay (half-open)."
    )
    freeze_all: bool = parameter(
        False, "The controller does nothing; its connections stay, and the joints brake."
    )
    drop_rtde: bool = parameter(False, "Once: RTDE connections are closed (FIN).")
    reset_connections: bool = parameter(
        False, "Once: all connections are reset (RST), the program's too."
    )
    refuse_connections: bool = parameter(False, "No port listens.")
    refuse_rtde_version: bool = parameter(False, "RTDE accepts no version of its protocol.")
    outputs_not_found: tuple[str, ...] = parameter((), "RTDE outputs that the controller lacks.")
    inputs_in_use: tuple[str, ...] = parameter((), "RTDE inputs that are reported to be in use.")
    timestamp_offset: float = parameter(
        0.0,
        "Offset of the RTDE timestamp, which then jumps forward or backward.",
        unit="s",
        low=-1e6,
        high=1e6,
    )
    split_at: int = parameter(
        0,
        "Number of bytes of each RTDE package that are sent at once, the rest a cycle later; all "
        "if 0.",
        low=0,
        high=65535,
    )
    coalesce: int = parameter(
        1, "Number of RTDE packages that are collected and then sent together.", low=1, high=125
    )


def active_faults(faults: UrFaultParameters) -> list[str]:
    """Return the names of the faults that are set."""
    defaults = UrFaultParameters()
    return [
        name
        for name in UrFaultParameters.__dataclass_fields__
        if getattr(faults, name) != getattr(defaults, name)
    ]
