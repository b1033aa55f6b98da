"""Parameters of the simulated faults of drives on a CAN bus."""

from dataclasses import dataclass, fields

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.simulation.can_drives.motor import DriveFaults
from omniman_ros.simulation.plant.parameters import Names, flags


@dataclass(frozen=True)
class CanFaultParameters(Validated):
    """Faults to simulate; wheels by name. All parameters may change at any time."""

    silent: Names = parameter((), "Wheels whose drive sends nothing; it still receives.")
    deaf: Names = parameter((), "Wheels whose drive receives nothing; it still sends.")
    frozen_reports: Names = parameter(
        (), "Wheels whose position and velocity reports stop; the heartbeat continues."
    )
    frozen_encoder: Names = parameter(
        (), "Wheels whose drive reports an unchanging position and velocity."
    )
    no_heartbeat: Names = parameter((), "Wheels whose drive's heartbeat stops; reports continue.")
    fault: Names = parameter(
        (), "Wheels whose drive has an error: it stops, and can be reset only after the error."
    )
    refuse_enable: Names = parameter((), "Wheels whose drive does not switch the motor on.")
    wrong_mode: Names = parameter((), "Wheels whose drive reports another mode than the one set.")
    stuck_status: Names = parameter((), "Wheels whose drive's status no longer changes.")
    configuration_refused: Names = parameter(
        (), "Wheels whose drive answers each write of its configuration with an error."
    )
    configuration_unanswered: Names = parameter(
        (), "Wheels whose drive does not answer reads and writes of its configuration."
    )
    short_reports: Names = parameter((), "Wheels whose drive's reports lack their last byte.")
    duplicated_reports: Names = parameter((), "Wheels whose drive sends each report twice.")
    reordered_reports: Names = parameter(
        (), "Wheels whose drive sends the later one of each pair of reports first."
    )
    reboot: Names = parameter((), "Wheels whose drive restarts when its name appears here.")
    supply: float = parameter(
        0.0,
        "Supply voltage of all drives; 0 selects that of the motor.",
        unit="V",
        low=0,
        high=1000,
    )
    lost_frames: float = parameter(
        0.0, "Probability that a frame is lost, to the drives and from them.", low=0, high=1
    )


#: Names of the faults that are on or off, the same in `CanFaultParameters` and `DriveFaults`
FAULT_FLAGS = tuple(field.name for field in fields(DriveFaults) if field.default is False)


def drive_faults(
    parameters: CanFaultParameters,
    names: Names,
    previous: CanFaultParameters | None = None,
    reboots: tuple[int, ...] = (),
) -> tuple[DriveFaults, ...]:
    """Return the faults of each wheel's drive.

    Args:
        previous: Faults until now: a drive restarts if its name is new in `reboot`.
        reboots: Number of restarts of each drive so far; empty if there were none.

    Raises:
        ParameterError: A name is not that of a wheel.
    """
    fault_flags = {
        name: flags(f"can_faults.{name}", getattr(parameters, name), names) for name in FAULT_FLAGS
    }
    reboot_flags = flags("can_faults.reboot", parameters.reboot, names)
    previous_reboot = previous.reboot if previous is not None else ()
    counts = reboots or (0,) * len(names)
    return tuple(
        DriveFaults(
            **{name: fault_flags[name][k] for name in FAULT_FLAGS},
            supply=parameters.supply,
            reboots=counts[k] + (reboot_flags[k] and wheel not in previous_reboot),
        )
        for k, wheel in enumerate(names)
    )
