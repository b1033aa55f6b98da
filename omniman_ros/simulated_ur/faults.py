"""Faults of the simulated controller, switched on and off by hand."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter


@dataclass(frozen=True, kw_only=True)
class UrFaultParameters:
    """Faults to try a client against. All are live.

    Those that happen once do so each time that their parameter becomes true.
    """

    protective_stop: bool = parameter(False, "Once: a protective stop comes.")
    emergency_stop: bool = parameter(False, "The emergency stop button is pressed.")
    pause_program: bool = parameter(False, "Once: the program is paused at the pendant.")
    freeze_program: bool = parameter(False, "The program does not run on; all else does.")
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
    inputs_in_use: tuple[str, ...] = parameter((), "RTDE inputs that somebody else writes.")
    timestamp_offset: float = parameter(
        0.0, "Added to RTDE's timestamp: it skips, or goes backward.", unit="s", low=-1e6,
        high=1e6,
    )  # fmt: skip
    split_at: int = parameter(
        0, "Bytes of each RTDE package that are sent at once, the rest a cycle later; 0: all.",
        low=0, high=65535,
    )  # fmt: skip
    coalesce: int = parameter(
        1, "Number of RTDE packages that are kept back and sent together.", low=1, high=125
    )


def active(faults: UrFaultParameters) -> list[str]:
    """Names of the faults that are set."""
    fresh = UrFaultParameters()
    return [
        name
        for name in UrFaultParameters.__dataclass_fields__
        if getattr(faults, name) != getattr(fresh, name)
    ]
