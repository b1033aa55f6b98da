"""Faults of simulated drives on a CAN bus, switched on and off by hand."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.drive.can.motor import DriveFaults
from omniman_ros.drive.parameters import Names, flags


@dataclass(frozen=True)
class CanFaultParameters:
    """Faults to try the bridge against; wheels by name, no name for none. All are live."""

    silent: Names = parameter((), "Wheels whose drive sends nothing; it still hears.")
    deaf: Names = parameter((), "Wheels whose drive hears nothing; it still sends.")
    frozen_reports: Names = parameter(
        (), "Wheels whose position and velocity reports stop; the heartbeat goes on."
    )
    frozen_encoder: Names = parameter(
        (), "Wheels whose drive reports the same position and velocity for ever."
    )
    no_heartbeat: Names = parameter((), "Wheels whose drive's heartbeat stops; reports go on.")
    fault: Names = parameter(
        (), "Wheels whose drive has an error: it stops, and can be reset only without it."
    )
    refuse_enable: Names = parameter((), "Wheels whose drive does not switch the motor on.")
    wrong_mode: Names = parameter((), "Wheels whose drive shows another mode than was asked for.")
    stuck_status: Names = parameter((), "Wheels whose drive's status stays as it was.")
    configuration_refused: Names = parameter(
        (), "Wheels whose drive answers each write of its configuration by an error."
    )
    configuration_unanswered: Names = parameter(
        (), "Wheels whose drive does not answer reads and writes of its configuration."
    )
    short_reports: Names = parameter((), "Wheels whose drive's reports lack their last byte.")
    duplicated_reports: Names = parameter((), "Wheels whose drive sends each report twice.")
    reordered_reports: Names = parameter(
        (), "Wheels whose drive sends of each two reports the later one first."
    )
    reboot: Names = parameter((), "Wheels whose drive starts anew when its name appears here.")
    supply: float = parameter(
        0.0, "Voltage of the supply of all drives; 0 for the motor's own.", unit="V", low=0,
        high=1000,
    )  # fmt: skip
    lost_frames: float = parameter(
        0.0, "Probability that a frame is lost, to the drives and from them.", low=0, high=1
    )


FLAGS = (
    "silent", "deaf", "frozen_reports", "frozen_encoder", "no_heartbeat", "fault",
    "refuse_enable", "wrong_mode", "stuck_status", "configuration_refused",
    "configuration_unanswered", "short_reports", "duplicated_reports", "reordered_reports",
)  # fmt: skip
"""Faults that a drive has or has not, named alike in parameters and drive."""


def drive_faults(
    parameters: CanFaultParameters,
    names: Names,
    before: CanFaultParameters | None = None,
    reboots: tuple[int, ...] = (),
) -> tuple[DriveFaults, ...]:
    """Give the faults of each wheel's drive.

    Args:
        parameters: All faults.
        names: Of the wheels.
        before: What held until now: who newly is to start anew does.
        reboots: How often each drive has done so; none if empty.

    Raises:
        ParameterError: A name is no wheel's.
    """
    chosen = {name: flags(f"can_faults.{name}", getattr(parameters, name), names)
              for name in FLAGS}  # fmt: skip
    again = flags("can_faults.reboot", parameters.reboot, names)
    old = before.reboot if before is not None else ()
    return tuple(
        DriveFaults(
            **{name: chosen[name][k] for name in FLAGS},
            supply=parameters.supply,
            reboots=(reboots[k] if reboots else 0) + (again[k] and wheel not in old),
        )
        for k, wheel in enumerate(names)
    )
