"""Parameters of the simulated drives: plant, part-to-part mismatch, firmware and faults.

Robot data (masses, motor, friction) is not here: it comes from `core.platform`. All of these are
live, unless marked read_only: :meth:`SimulatedDrives.set_parameters` takes a new set at any time.
"""

from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

Floats = tuple[float, ...]  #: One value for all wheels, or one per wheel
Names = tuple[str, ...]  #: Names of wheels


@dataclass(frozen=True)
class PlantParameters(Validated):
    """Floor, contact and integration."""

    substep: float = parameter(
        0.001,
        "Integration step; also the period of the firmware's loops.",
        unit="s",
        low=1e-5,
        high=0.01,
        read_only=True,
    )
    slip_velocity: float = parameter(
        0.005,
        "Slip along the roller's axis at which 71 % of the grip mu N is reached (v_s).",
        unit="m/s",
        low=1e-7,
        high=1,
    )
    roller_velocity: float = parameter(
        0.01,
        "Rolling speed of a roller at which 71 % of its drag is reached.",
        unit="m/s",
        low=1e-7,
        high=1,
    )
    breakaway: float = parameter(
        1.2,
        "Ratio of the torque that moves a wheel at rest to its Coulomb friction in motion.",
        low=1,
        high=10,
    )
    gravity: float = parameter(9.81, "Gravity.", unit="m/s^2", low=0, high=30)
    lifted: bool = parameter(False, "The platform stands on blocks: wheels rotate freely.")
    patch_x_min: float = parameter(0.0, "Slippery patch in the world, x from.", unit="m")
    patch_x_max: float = parameter(
        0.0, "Slippery patch, x to; none if not above x from.", unit="m"
    )
    patch_y_min: float = parameter(0.0, "Slippery patch in the world, y from.", unit="m")
    patch_y_max: float = parameter(
        0.0, "Slippery patch, y to; none if not above y from.", unit="m"
    )
    patch_mu: float = parameter(0.1, "Coefficient of friction on the patch.", low=0, high=5)


@dataclass(frozen=True)
class MismatchParameters(Validated):
    """How each real wheel differs from the robot's data; one value or one per wheel.

    Offsets and angles are added to where the robot's data has the wheel and its rollers.
    """

    friction: Floats = parameter((1.0,), "Factor on viscous and Coulomb friction.", low=0, high=10)
    torque_constant: Floats = parameter((1.0,), "Factor on the motor's K.", low=0.1, high=10)
    amplifier_gain: Floats = parameter(
        (1.0,), "Ratio of the applied to the requested voltage.", low=0.1, high=10
    )
    radius: Floats = parameter((1.0,), "Factor on the wheel's radius.", low=0.5, high=2)
    offset_x: Floats = parameter(
        (0.0,),
        "Distance by which the contact point lies further forward.",
        unit="m",
        low=-0.2,
        high=0.2,
    )
    offset_y: Floats = parameter(
        (0.0,),
        "Distance by which the contact point lies further to the left.",
        unit="m",
        low=-0.2,
        high=0.2,
    )
    heading: Floats = parameter(
        (0.0,),
        "Angle by which the mounted wheel is rotated to the left.",
        unit="rad",
        low=-0.3,
        high=0.3,
    )
    roller_angle: Floats = parameter(
        (0.0,),
        "Angle by which the rollers are rotated to the left on the wheel.",
        unit="rad",
        low=-0.3,
        high=0.3,
    )


@dataclass(frozen=True)
class FirmwareParameters(Validated):
    """Parameters of the drive units; all wheels have the same."""

    velocity_bandwidth: float = parameter(
        20.0,
        "Bandwidth of the velocity loop; its gain is the bandwidth times the wheel's fraction "
        "of the robot's inertia.",
        unit="rad/s",
        low=0,
        high=1000,
    )
    integral_time: float = parameter(
        0.1, "Integral time of the velocity loop.", unit="s", low=0.001, high=100
    )
    current_time: float = parameter(
        0.004,
        "Closed-loop time constant of the current loop (torque mode).",
        unit="s",
        low=0.0005,
        high=1,
    )
    observer_window: float = parameter(
        0.004,
        "Shortest time between the two encoder edges that give the velocity.",
        unit="s",
        low=0.0001,
        high=1,
    )
    observer_timeout: float = parameter(
        0.25,
        "Time without an encoder edge after which the velocity is reported as zero.",
        unit="s",
        low=0.01,
        high=10,
    )
    encoder_tolerance: float = parameter(
        1.0,
        "Difference between encoder and back-EMF at which, if it lasts, all drives stop.",
        unit="rad/s",
        low=0.01,
        high=1e6,
    )
    watchdog: float = parameter(
        0.1,
        "Time after the last valid command at which the drives ramp to rest by themselves.",
        unit="s",
        low=0.005,
        high=10,
    )
    deceleration: float = parameter(
        9.0,
        "Ramp of the wheel speed to rest when the watchdog has run out.",
        unit="rad/s^2",
        low=0.01,
        high=10000,
    )
    quick_stop_deceleration: float = parameter(
        9.0, "Ramp of the wheel speed in a quick stop.", unit="rad/s^2", low=0.01, high=10000
    )
    acceleration: float = parameter(
        30.0,
        "Ramp to the first setpoint after the start, a stop or a change of mode.",
        unit="rad/s^2",
        low=0.01,
        high=10000,
    )


@dataclass(frozen=True)
class FaultParameters(Validated):
    """Faults to test the controller against; wheels are given by name."""

    dead_motor: Names = parameter((), "Wheels whose motor circuit is open: no torque.")
    stuck_wheel: Names = parameter((), "Wheels that are blocked.")
    frozen_encoder: Names = parameter(
        (), "Wheels whose position and velocity feedback stand still."
    )
    lost_messages: float = parameter(
        0.0, "Probability that a state report is dropped (applied by the node).", low=0, high=1
    )
    late_messages: float = parameter(
        0.0, "Delay of the state reports (applied by the node).", unit="s", low=0, high=5
    )
    current_noise: float = parameter(
        0.0, "Standard deviation of the measured current.", unit="A", low=0, high=100
    )


@dataclass(frozen=True)
class SimulationParameters(Validated):
    """All parameters of the simulated drives; `core.parameters.build(cls, {})` has defaults."""

    plant: PlantParameters
    mismatch: MismatchParameters
    firmware: FirmwareParameters
    faults: FaultParameters


def per_wheel(name: str, values: Floats, n: int) -> Floats:
    """Return n values of one or n; other numbers of them raise a ParameterError."""
    if len(values) not in (1, n):
        raise ParameterError(name, values, f"must have one value or {n}, one per wheel")
    return values if len(values) == n else values * n


def flags(name: str, chosen: Names, names: Names) -> tuple[bool, ...]:
    """Return which of `names` are chosen; a choice beyond them raises a ParameterError."""
    for wheel in chosen:
        if wheel not in names:
            raise ParameterError(name, wheel, f"must be one of {', '.join(names)}")
    return tuple(wheel in chosen for wheel in names)
