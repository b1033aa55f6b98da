"""Identification of masses, friction and gear efficiency from a drive on the floor.

Intervals are those of a delete-a-block jackknife: the drive is cut into blocks of time, each is
left out in turn, and the spread of the results counts. That needs no model of the errors, which
persist over time here. An error that is the same in all blocks is not in the intervals, such as a
law of friction that is wrong everywhere.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.control.dynamics import GRAVITY, PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Friction, Platform
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.motor_fit import MotorFit, fit_motors
from omniman_ros.identification.floor.regressor import (
    EFFICIENCY_SPREAD,
    Equations,
    FloorModel,
    SignWidths,
)
from omniman_ros.identification.floor.solution import (
    WINDOW_STEP,
    WINDOW_WIDTH,
    Directions,
    find_directions,
    groups,
)
from omniman_ros.identification.floor.windows import Windows
from omniman_ros.identification.friction.robust_statistics import NORMAL_95, student_95

BLOCKS = 20  #: Number of blocks of time of the jackknife
WHEEL_WIDTHS = (0.005, 0.01, 0.02, 0.05, 0.1)  #: Tried widths of the wheels' sign function [rad/s]
#: Widths of the rollers' sign function that are tried [m/s]
ROLLER_WIDTHS = (0.002, 0.005, 0.01, 0.015, 0.022, 0.033, 0.05)
MAX_UNDETERMINED = 0.2  #: Largest undetermined part of a quantity that counts as determined
DIRECTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "at 45 degrees": (math.sqrt(0.5), math.sqrt(0.5), 0.0),
    "sideways": (0.0, 1.0, 0.0),
    "at 135 degrees": (-math.sqrt(0.5), math.sqrt(0.5), 0.0),
    "turning": (0.0, 0.0, 1.0),
}  #: Twists whose friction is reported [m/s, m/s, rad/s]
SLOPES = {"x": -3, "y": -2}  #: Indices of the unknowns for the slope of the floor


@dataclass(frozen=True)
class FloorEstimate:
    """An identified quantity."""

    value: float
    half_width: float  #: Half width of its 95 % interval
    before: float  #: Value by the configuration
    is_determined: bool  #: Whether the drive determines it by itself


@dataclass(frozen=True, eq=False)
class FloorFit:
    """Result of the identification."""

    robot: Platform  #: The robot as identified; what is not determined is as configured
    #: Quantities by name: mass, com_x, com_y, inertia (about the centre of mass) of platform and
    #: arm together, wheel_inertia (over the configured), gear_efficiency, `viscous.WHEEL`,
    #: `coulomb.WHEEL`, `drag.WHEEL` [N], `drag DIRECTION` and `friction DIRECTION` (CCTA 2017 (23)
    #: at 1 m/s and 1 rad/s [N, N m]), slope_x and slope_y [rad], and `back_emf.WHEEL` [V s/rad].
    estimates: dict[str, FloorEstimate]
    #: Names of the unknowns that the drive cannot tell apart, in groups; a group of one has too
    #: little effect.
    inseparable: list[tuple[str, ...]]
    widths: SignWidths  #: Widths of the sign functions that explain the drive best
    is_back_emf_measured: bool  #: Whether they are measured; if not, the configured ones count
    is_efficiency_bounded: bool  #: Whether the efficiency was kept at its bound of 1
    residual: Array  #: (3,) RMS of what the model does not explain [N, N, N m]
    typical: Array  #: (3,) RMS of the motors' forces and torque [N, N, N m]


def identify_floor(drive: FloorDrive, robot: Platform) -> FloorFit:
    """Identify a robot from a drive on the floor.

    Raises:
        InputError: The drive is too short or has gaps.
        ParameterError: The result is no possible robot.
    """
    windows = Windows(drive.start, drive.end, WINDOW_WIDTH, WINDOW_STEP)
    motors = fit_motors(drive, windows)
    nominal = np.full(robot.wheel_count, robot.motor.gear_ratio * robot.motor.torque_constant)
    back_emf = nominal if motors is None else motors.back_emf
    model = FloorModel(robot)
    equations, directions, widths = _best_widths(model, drive, back_emf, windows)
    unknowns = directions.solve(model, equations)
    # The moment of a slope's force depends on the centre of mass, so that one repetition follows.
    model = model.with_com(unknowns[1:3] / unknowns[0])
    equations = model.equations(drive, back_emf, windows, widths)
    directions = find_directions(model, equations)
    unknowns = directions.solve(model, equations)
    half_widths = _half_widths(model, equations, directions, drive, windows, motors)
    is_bounded = bool(unknowns[-1] < 1.0)
    efficiency = list(_quantities(model, unknowns, back_emf)).index("gear_efficiency")
    is_uncertain = half_widths[efficiency] > EFFICIENCY_SPREAD * robot.motor.gear_efficiency
    if is_bounded or is_uncertain:
        model = model.with_bound() if is_bounded else model.without_gear()
        directions = find_directions(model, equations)
        unknowns = directions.solve(model, equations)
        half_widths = _half_widths(model, equations, directions, drive, windows, motors)
    values = _quantities(model, unknowns, back_emf)
    spread, parts = _undetermined(model, directions, unknowns, back_emf)
    before = configured_quantities(robot)
    residuals = equations.matrix @ unknowns - equations.values
    return FloorFit(
        identified_robot(robot, values),
        {
            name: FloorEstimate(
                value,
                float(np.hypot(half_widths[k], NORMAL_95 * spread[k])),
                before[name],
                bool(parts[k] <= MAX_UNDETERMINED),
            )
            for k, (name, value) in enumerate(values.items())
        },
        groups(model, directions),
        widths,
        motors is not None,
        is_bounded,
        np.sqrt((residuals**2).mean(axis=0)),
        np.sqrt((equations.values**2).mean(axis=0)),
    )


def _best_widths(
    model: FloorModel, drive: FloorDrive, back_emf: Array, windows: Windows
) -> tuple[Equations, Directions, SignWidths]:
    """Return the equations with the widths that leave the least residual."""

    def attempt(widths: SignWidths) -> tuple[Equations, Directions, SignWidths]:
        equations = model.equations(drive, back_emf, windows, widths)
        return equations, find_directions(model, equations), widths

    def residual(attempted: tuple[Equations, Directions, SignWidths]) -> float:
        equations, directions, _ = attempted
        residuals = equations.matrix @ directions.solve(model, equations) - equations.values
        squares = (residuals**2).mean(axis=0) / (equations.values**2).mean(axis=0)
        return float(squares.sum())

    widths = SignWidths()
    rollers = [attempt(replace(widths, roller=width)) for width in ROLLER_WIDTHS]
    widths = min(rollers, key=residual)[2]
    wheels = [attempt(replace(widths, wheel=width)) for width in WHEEL_WIDTHS]
    widths = min(wheels, key=residual)[2]
    rollers = [attempt(replace(widths, roller=width)) for width in ROLLER_WIDTHS]
    return min(rollers, key=residual)


def _quantities(model: FloorModel, unknowns: Array, back_emf: Array) -> dict[str, float]:
    efficiency = float(max(unknowns[-1], 1e-9) ** -0.5)
    mass, moment_x, moment_y, inertia, wheels, *_ = unknowns * efficiency
    x, y = moment_x / mass, moment_y / mass
    values = {
        "mass": mass,
        "com_x": x,
        "com_y": y,
        "inertia": inertia - mass * (x * x + y * y),
        "wheel_inertia": wheels,
        "gear_efficiency": efficiency,
    }
    values |= dict(zip(model.names[5:-3], unknowns[5:-3] * efficiency, strict=True))
    viscous, coulomb, drag = (
        unknowns[model.index(kind)] * efficiency for kind in ("viscous", "coulomb", "drag")
    )
    for name, twist in DIRECTIONS.items():
        rolling = np.abs(model.rolling @ twist)
        turning = np.abs(model.kinematics.J @ twist)
        rollers = drag @ rolling
        values[f"drag {name}"] = rollers
        values[f"friction {name}"] = rollers + coulomb @ turning + viscous @ (turning * turning)
    weight = GRAVITY * mass
    values |= {f"slope_{axis}": unknowns[k] * efficiency / weight for axis, k in SLOPES.items()}
    names = model.robot.wheels.names
    values |= {f"back_emf.{name}": k for name, k in zip(names, back_emf, strict=True)}
    return {name: float(value) for name, value in values.items()}


def configured_quantities(robot: Platform) -> dict[str, float]:
    """Return the quantities of :class:`FloorFit` that a robot's parameters say."""
    motor = robot.motor
    back_emf = np.full(robot.wheel_count, motor.gear_ratio * motor.torque_constant)
    model = FloorModel(robot)
    return _quantities(model, model.expected, back_emf)


def _half_widths(
    model: FloorModel,
    equations: Equations,
    directions: Directions,
    drive: FloorDrive,
    windows: Windows,
    motors: MotorFit | None,
) -> Array:
    """Return the half widths of the quantities' 95 % intervals by the jackknife.

    The equations take the motor constants of the whole drive as known: the spread of a constant is
    in its own interval only, not in those of the forces, masses and torques that it scales.
    """
    count = len(windows.centres)
    block = np.arange(count) * BLOCKS // count
    results = []
    for left_out in range(BLOCKS):
        kept = block != left_out
        unknowns = directions.solve(model, equations, kept)
        found = fit_motors(drive, windows, kept) if motors is not None else None
        back_emf = np.ones(model.robot.wheel_count) if found is None else found.back_emf
        results.append(list(_quantities(model, unknowns, back_emf).values()))
    table = np.array(results)
    deviation = table - table.mean(axis=0)
    variance = (BLOCKS - 1) / BLOCKS * (deviation**2).sum(axis=0)
    result: Array = student_95(BLOCKS - 1) * np.sqrt(variance)
    return result


def _undetermined(
    model: FloorModel, directions: Directions, unknowns: Array, back_emf: Array
) -> tuple[Array, Array]:
    """Return what the undetermined unknowns do to each quantity.

    Returns:
        The standard deviation of each quantity by their expected deviations, and their part in the
        gradient of each quantity, 0 to 1.
    """
    start = np.array(list(_quantities(model, unknowns, back_emf).values()))
    steps = 1e-4 * model.spread
    gradient = np.array(
        [
            np.array(list(_quantities(model, unknowns + step, back_emf).values())) - start
            for step in np.diag(steps)
        ]
    )
    gradient = gradient.T / 1e-4
    spread = np.linalg.norm(gradient @ directions.projector, axis=1)
    return spread, spread / np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)


def identified_robot(robot: Platform, values: dict[str, float]) -> Platform:
    """Return the robot as identified, the arm as configured; it may raise a ParameterError."""
    arm, wheels = robot.arm, robot.wheels
    mass, x, y = values["mass"], values["com_x"], values["com_y"]
    rest = mass - arm.mass
    bx, by = (mass * x - arm.mass * arm.com_x) / rest, (mass * y - arm.mass * arm.com_y) / rest
    about_base = values["inertia"] + mass * (x * x + y * y)
    of_arm = arm.inertia + arm.mass * (arm.com_x**2 + arm.com_y**2)
    inertia = about_base - of_arm - rest * (bx * bx + by * by)

    def per_wheel(kind: str) -> tuple[float, ...]:
        return tuple(max(values[f"{kind}.{name}"], 0.0) for name in wheels.names)

    constant = float(np.mean([values[f"back_emf.{name}"] for name in wheels.names]))
    found = replace(
        robot,
        body=replace(robot.body, mass=rest, com_x=bx, com_y=by, inertia=inertia),
        motor=replace(
            robot.motor,
            gear_efficiency=values["gear_efficiency"],
            torque_constant=constant / robot.motor.gear_ratio,
        ),
        wheels=replace(wheels, inertia=tuple(values["wheel_inertia"] * i for i in wheels.inertia)),
    )
    loads = PlatformDynamics(found, PlatformKinematics(found.wheels)).loads
    roller = np.array(per_wheel("drag")) / np.maximum(loads, 1e-9)
    friction = Friction(
        viscous=per_wheel("viscous"),
        coulomb=per_wheel("coulomb"),
        roller=tuple(roller.tolist()),
        mu=robot.friction.mu,
    )
    return replace(found, friction=friction)
