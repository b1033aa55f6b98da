"""Configuration of a CiA 402 drive before its start, as a dialogue of SDOs.

Sources: CiA 301 7.5.2 (communication), IEC 61800-7-201 (profile). The drive is pre-operational, so
that no PDO moves it meanwhile.
"""

import math
from dataclasses import dataclass

from canopen.profiles.p402 import OperationMode

from omniman_ros.can_drives.axis import AxisSettings
from omniman_ros.can_drives.cia402.canopen import Entry, abort_text
from omniman_ros.can_drives.cia402.objects import (
    ABORT_OPTION,
    CONSUMER_HEARTBEAT,
    CONTROLWORD,
    CYCLE,
    CYCLE_EXPONENT,
    DEVICE_TYPE,
    ERROR_BEHAVIOUR,
    FAULT_REACTION_OPTION,
    MODE,
    PRODUCER_HEARTBEAT,
    PROFILE,
    QUICK_STOP_DECELERATION,
    QUICK_STOP_OPTION,
    RATED_TORQUE,
    RPDO_OFFSET,
    RPDO_TORQUE,
    RPDO_VELOCITY,
    STATUSWORD,
    SUPPORTED_MODES,
    TARGET_TORQUE,
    TARGET_VELOCITY,
    TORQUE_OFFSET,
    TPDO_ERROR,
    TPDO_MOTION,
    TPDO_STATUS,
    TPDO_SUPPLY,
    VELOCITY_OFFSET,
    PdoMapping,
)
from omniman_ros.can_drives.cia402.sdo import (
    ABSENT_CODES,
    Request,
    SdoError,
    Steps,
    answer_value,
    read,
    try_write,
    write,
)
from omniman_ros.can_drives.cia402.state import DISABLE_VOLTAGE, POWERED, pds_state
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import ParameterError

HOST_NODE = 127  #: Node id of this host, in its heartbeat

MODE_NAMES = {
    DriveMode.VELOCITY: ("CYCLIC SYNCHRONOUS VELOCITY", "PROFILED VELOCITY"),
    DriveMode.TORQUE: ("CYCLIC SYNCHRONOUS TORQUE", "PROFILED TORQUE"),
}  #: Suitable modes of operation by mode of the setpoint, the preferred one first

#: Accepted quick stop option codes (object 605A): ramp and stay in quick stop, or switch off
QUICK_STOP_OPTIONS = (6, 2)
#: Accepted abort connection option codes (object 6007): quick stop, or a fault's own reaction.
#: The option applies to a missing heartbeat of the host, bus-off, reset and NMT stop.
ABORT_OPTIONS = (3, 1)
#: Fault reaction option code (object 605E): ramp of the quick stop, if the fault allows it
QUICK_STOP_ON_FAULT = 2

#: Error behaviour (object 1029:01) in which a drive remains operational without the host.
#: It then still reports how its wheel comes to rest.
STAYS_OPERATIONAL = 1

#: Shortest time that a drive is given to switch its power off [s].
#: It may have to engage a brake, or be in its reaction to a fault.
POWER_OFF_TIMEOUT = 1.0
#: Largest relative deviation of the deceleration, which drives round
DECELERATION_TOLERANCE = 0.05
#: Largest relative deviation of the heartbeat: two must fit into three periods
HEARTBEAT_TOLERANCE = 0.5
#: Largest plausible ratio of the rated to the largest torque, or its inverse.
#: Manufacturers differ in the unit of the rated torque (object 6076, in mN m by the profile): with
#: uN m all torques would be a thousand times too small or too large.
MAX_TORQUE_RATIO = 50.0

PDO_DISABLED = 1 << 31  #: Bit of a PDO's COB-id that disables the PDO
#: Bit of a PDO's COB-id that forbids remote requests; its value is left to the drive
NO_RTR = 1 << 30


@dataclass(frozen=True)
class Abilities:
    """Abilities of a drive that the dialogue has found."""

    modes: dict[DriveMode, int]  #: Mode of operation by mode of the setpoint
    rated_torque: float  #: Rated torque of the motor [N m]
    #: PDO that reports error and supply voltage; None if the drive has none
    supply: PdoMapping | None


@dataclass(frozen=True)
class DriveNumbers:
    """Settings in the drive's units."""

    consumer_heartbeat: int  #: Consumer heartbeat time (object 1016:01): node id << 16 | time [ms]
    producer_heartbeat: int  #: Producer heartbeat time (object 1017) [ms]
    quick_stop_deceleration: int  #: Quick stop deceleration (object 6085) [velocity units/s]
    cycle: int  #: Mantissa of the cycle time (object 60C2:01)
    #: Exponent of the cycle time (object 60C2:02), which is cycle x 10^cycle_exponent [s]
    cycle_exponent: int


def check_settings(settings: AxisSettings) -> None:
    """Check that settings can be written to a drive.

    Raises:
        ParameterError: The node is invalid or that of the host; a number is not positive, not
            finite or does not fit into the drive's integer.
    """
    if not 1 <= settings.node < HOST_NODE:
        reason = f"must be 1 to {HOST_NODE - 1}; this host is {HOST_NODE}"
        raise ParameterError("can.nodes", settings.node, reason)
    for name in ("period", "counts", "velocity_scale", "torque_constant", "feedback_timeout"):
        if not 0.0 < (value := getattr(settings, name)) < math.inf:
            raise ParameterError(f"can.{name}", value, "must be positive and finite")
    for name in ("max_speed", "max_torque"):
        if not (value := getattr(settings, name)) > 0.0:
            raise ParameterError(f"can.{name}", value, "must be positive")
    if not 0.0 <= settings.rated_torque < math.inf:
        raise ParameterError("can.rated_torque", settings.rated_torque, "must be finite and >= 0")
    drive_numbers(settings)


def drive_numbers(settings: AxisSettings) -> DriveNumbers:
    """Convert settings to the drive's units; raise ParameterError if one does not fit."""
    ramp = settings.quick_stop_deceleration / math.tau * settings.velocity_scale
    cycle, exponent = _cycle(settings.period)
    return DriveNumbers(
        HOST_NODE << 16 | _integer("heartbeat_timeout", 1e3 * settings.heartbeat_timeout, 0xFFFF),
        _integer("drive_heartbeat", 1e3 * settings.drive_heartbeat, 0xFFFF),
        _integer("quick_stop_deceleration", ramp, 0xFFFF_FFFF),
        cycle,
        exponent,
    )


def _integer(name: str, value: float, high: int) -> int:
    if not (math.isfinite(value) and 1 <= round(value) <= high):
        reason = f"must be 1 to {high} in the drive's unit, got {value:g}"
        raise ParameterError(f"can.{name}", value, reason)
    return round(value)


def _cycle(period: float) -> tuple[int, int]:
    """Return mantissa (up to 255) and power of ten of a period.

    The result is the coarsest that is exact, or else the nearest. A drive interpolates over the
    period: 33e-4 s for 1/300 s is close enough.
    """
    candidates = [(round(period / 10.0**e), e) for e in (-3, -4, -5, -6, -2, -1)]
    fitting = [(m, e) for m, e in candidates if 1 <= m <= 255]
    if not fitting:
        raise ParameterError(
            "can.rate", 1.0 / period, "its period must fit into object 60C2 (interpolation time)"
        )
    return min(fitting, key=lambda c: round(abs(c[0] * 10.0 ** c[1] / period - 1.0), 6))


def setup(settings: AxisSettings) -> Steps[Abilities]:
    """Switch the power off, find the abilities, configure the stops, and map the PDOs.

    Setpoints and offsets are zeroed: a stale one would move the motor when it is enabled. Values
    that must not fail unnoticed are read back.

    Raises:
        SdoError: The drive refuses a request, lacks a mode, or did not keep a value.
    """
    numbers = drive_numbers(settings)
    # The power is switched off first: the motor may still rotate, and the drive may receive
    # frames although its answers are lost.
    yield from try_write(CONTROLWORD, DISABLE_VOLTAGE)
    device_type = yield from read(DEVICE_TYPE)
    if device_type & 0xFFFF != PROFILE:
        raise SdoError(f"is no CiA 402 drive: device type {device_type:08X}")
    yield from _wait_for_power_off(settings)
    modes = yield from _modes(settings)
    rated_torque = settings.rated_torque or (yield from _rated_torque(settings))
    yield from write(TARGET_VELOCITY, 0)
    for entry in (TARGET_TORQUE, VELOCITY_OFFSET, TORQUE_OFFSET):
        yield from write(entry, 0, ABSENT_CODES)  # an entry that is needed is mapped as well
    yield from _write_verified(CONSUMER_HEARTBEAT, numbers.consumer_heartbeat)
    yield from _write_verified(PRODUCER_HEARTBEAT, numbers.producer_heartbeat, HEARTBEAT_TOLERANCE)
    yield from _option(QUICK_STOP_OPTION, QUICK_STOP_OPTIONS)
    yield from _write_verified(
        QUICK_STOP_DECELERATION, numbers.quick_stop_deceleration, DECELERATION_TOLERANCE
    )
    yield from _option(ABORT_OPTION, ABORT_OPTIONS)
    yield from try_write(FAULT_REACTION_OPTION, QUICK_STOP_ON_FAULT)
    yield from try_write(ERROR_BEHAVIOUR, STAYS_OPERATIONAL)
    yield from _write_cycle(numbers)
    supply = yield from _map_all(settings, DriveMode.TORQUE in modes)
    return Abilities(modes, rated_torque, supply)


def _wait_for_power_off(settings: AxisSettings) -> Steps[None]:
    for _ in range(math.ceil(POWER_OFF_TIMEOUT / settings.period)):  # at most one read per tick
        word = yield from read(STATUSWORD)
        if pds_state(word) not in POWERED:
            return
    raise SdoError(f"keeps power on the motor: statusword {word:04X} after disable voltage")


def _modes(settings: AxisSettings) -> Steps[dict[DriveMode, int]]:
    """Find a mode for each kind of setpoint, and leave the drive in the one for velocities.

    A drive may list modes that it refuses, for example those of another fieldbus.
    """
    supported = yield from read(SUPPORTED_MODES)
    needed = [DriveMode.VELOCITY]
    if settings.mode is not DriveMode.VELOCITY:  # voltages are converted into torques
        needed.insert(0, DriveMode.TORQUE)
    modes = {}
    for setpoint_mode in needed:
        reported = f"{SUPPORTED_MODES} is {supported:08X}"
        for name in MODE_NAMES[setpoint_mode]:
            code = OperationMode.NAME2CODE[name]
            if not supported & OperationMode.SUPPORTED[name]:
                continue
            abort = yield from try_write(MODE, code)
            if not abort:
                modes[setpoint_mode] = code
                break
            reported += f"; SDO {MODE} = {code}: abort {abort_text(abort)}"
        else:
            lacking = " nor ".join(name.lower() for name in MODE_NAMES[setpoint_mode])
            raise SdoError(f"accepts neither {lacking} mode: {reported}")
    return modes


def _rated_torque(settings: AxisSettings) -> Steps[float]:
    torque = 1e-3 * (yield from read(RATED_TORQUE))
    if (
        not settings.max_torque / MAX_TORQUE_RATIO
        <= torque
        <= settings.max_torque * MAX_TORQUE_RATIO
    ):
        reason = f"{torque:g} N m, with at most {settings.max_torque:g} N m at this motor"
        raise SdoError(f"{RATED_TORQUE} is {reason}: set can.rated_torque")
    return torque


def _option(entry: Entry, choices: tuple[int, ...]) -> Steps[None]:
    """Write the first choice that the drive accepts, if it has the entry."""
    for option in choices:
        abort = yield from try_write(entry, option)
        if abort in ABSENT_CODES:
            return
        if not abort:
            break
    # The value afterwards decides: the drive may have one of the choices as a constant.
    value = yield from read(entry)
    if value not in choices:
        options = " or ".join(map(str, choices))
        raise SdoError(f"{entry} stays {value}, but must be {options}")


def _write_cycle(numbers: DriveNumbers) -> Steps[None]:
    """Write the time over which setpoints are interpolated; the drive may refuse it."""
    if (yield from try_write(CYCLE_EXPONENT, numbers.cycle_exponent)):
        answer = yield Request(CYCLE_EXPONENT)
        if answer.data is None or CYCLE_EXPONENT.unpack(answer.data) != numbers.cycle_exponent:
            return
    yield from try_write(CYCLE, numbers.cycle)


def _write_verified(entry: Entry, value: int, tolerance: float = 0.0) -> Steps[None]:
    """Write an entry and read it back, with a tolerance relative to the value."""
    yield from write(entry, value)
    actual = yield from read(entry)
    if abs(actual - value) > tolerance * value + (1 if tolerance else 0):
        raise SdoError(f"{entry} reads {actual} after {value} was written")


def _map_all(settings: AxisSettings, torque: bool) -> Steps[PdoMapping | None]:
    """Map the PDOs that are used, and disable the others; return the PDO of the supply voltage."""
    used = [RPDO_VELOCITY, TPDO_STATUS, TPDO_MOTION]
    used += [RPDO_TORQUE] if torque else []
    used += [RPDO_OFFSET] if settings.feed_forward else []
    used_names = {pdo.name for pdo in used}
    all_pdos = [
        PdoMapping(number, transmit) for number in range(1, 5) for transmit in (False, True)
    ]
    for pdo in all_pdos:
        if pdo.name not in used_names:
            yield from _disable(pdo)
    for pdo in used:
        if refusal := (yield from _map(pdo, settings.node)):
            raise SdoError(refusal)
    for pdo in (TPDO_SUPPLY, TPDO_ERROR):
        if not (yield from _map(pdo, settings.node)):
            return pdo
    return None


def _disable(pdo: PdoMapping) -> Steps[None]:
    cob_id = yield from _cob_id(pdo)
    if cob_id is not None and not cob_id & PDO_DISABLED:
        # A PDO that stays enabled is ignored: it only loads the bus.
        yield from try_write(pdo.cob_id, cob_id | PDO_DISABLED)


def _cob_id(pdo: PdoMapping) -> Steps[int | None]:
    """Return the COB-id of a PDO, or None if there is no such PDO."""
    answer = yield Request(pdo.cob_id)
    if answer.abort in ABSENT_CODES:
        return None
    return answer_value(pdo.cob_id, answer)


def _map(pdo: PdoMapping, node: int) -> Steps[str]:
    """Map a PDO by the procedure of CiA 301 7.5.2.36; return why it was refused, or "".

    A refused PDO is left disabled.
    """
    previous = yield from _cob_id(pdo)
    if previous is None:
        return f"has no {pdo.name}"
    cob_id = previous & NO_RTR | pdo.base + node
    writes = [
        (pdo.cob_id, previous | PDO_DISABLED),
        (pdo.transmission, pdo.period),
        (pdo.mapping(0), 0),
        *((pdo.mapping(sub), entry.mapping) for sub, entry in enumerate(pdo.entries, 1)),
        (pdo.mapping(0), len(pdo.entries)),
        (pdo.cob_id, cob_id),
    ]
    for entry, value in writes:
        if abort := (yield from try_write(entry, value)):
            return f"SDO {entry} = {value:X}: abort {abort_text(abort)}"
    count = yield from read(pdo.mapping(0))
    actual = yield from read(pdo.cob_id)
    if count != len(pdo.entries) or (actual ^ cob_id) & ~NO_RTR:
        raise SdoError(f"{pdo.name} was not accepted: {count} entries, COB-id {actual:08X}")
    return ""
