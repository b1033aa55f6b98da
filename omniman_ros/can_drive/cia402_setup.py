"""What a CiA 402 drive is asked and told before it may be started: a dialogue of SDOs.

CiA 301 7.5.2 (communication), IEC 61800-7-201 (profile). The drive is pre-operational: no PDO
moves it meanwhile.
"""

import math
from dataclasses import dataclass

from canopen.profiles.p402 import OperationMode

from omniman_ros.can_drive.axis import AxisSettings
from omniman_ros.can_drive.canopen import Entry, abort_text
from omniman_ros.can_drive.cia402_objects import (
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
    Pdo,
)
from omniman_ros.can_drive.cia402_state import DISABLE_VOLTAGE, POWERED, pds_state
from omniman_ros.can_drive.sdo import ABSENT, Request, SdoError, Steps, attempt, got, read, write
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.wheel_cascade import DriveMode

MASTER = 127
"""Node id of this host's heartbeat."""

MODES = {
    DriveMode.VELOCITY: ("CYCLIC SYNCHRONOUS VELOCITY", "PROFILED VELOCITY"),
    DriveMode.TORQUE: ("CYCLIC SYNCHRONOUS TORQUE", "PROFILED TORQUE"),
}
"""Modes of operation that serve what is asked for, the better one first."""

QUICK_STOP_OPTIONS = (6, 2)
"""605A: ramp and stay in quick stop; or ramp and switch off."""
ABORT_OPTIONS = (3, 1)
"""6007, when the heartbeat of the host fails, on bus-off, reset and NMT stop: quick stop; or a
fault, with its own reaction."""
QUICK_STOP_ON_FAULT = 2
"""605E: ramp of the quick stop, where the fault leaves one."""

STAYS_OPERATIONAL = 1
"""1029:01: it goes on reporting how its wheel comes to rest when the host's heartbeat is lost."""

POWER_PATIENCE = 1.0
"""How long at least a drive may take to take the power off, s: it may have to set a brake, or be
in its reaction to a fault."""
SHARE = 0.05
"""Part by which the deceleration may be off: drives round it."""
HEARTBEAT_SHARE = 0.5
"""Part by which the heartbeat may be off: three of them are waited for, so two must fit."""
PLAUSIBLE = 50.0
"""Largest ratio of rated torque and largest torque. Makers differ in the unit of 6076 (mN m in the
profile): one of uN m would make all torques a thousand times too small or too large."""

UNUSED, NO_RTR = 1 << 31, 1 << 30
"""Bits of a PDO's COB-id; the second is the drive's own matter."""


@dataclass(frozen=True)
class Abilities:
    """What the dialogue found out.

    Attributes:
        modes: Mode of operation for each drive mode.
        rated_torque: N m.
        supply: The PDO with what is told of error and supply, if any.
    """

    modes: dict[DriveMode, int]
    rated_torque: float
    supply: Pdo | None


@dataclass(frozen=True)
class Numbers:
    """Settings in the drive's units.

    Attributes:
        consumer_heartbeat: 1016:01.
        producer_heartbeat: 1017.
        quick_stop_deceleration: 6085, velocity units/s.
        cycle, cycle_exponent: 60C2, cycle x 10^exponent seconds.
    """

    consumer_heartbeat: int
    producer_heartbeat: int
    quick_stop_deceleration: int
    cycle: int
    cycle_exponent: int


def check(settings: AxisSettings) -> None:
    """See that a drive can be told the settings.

    Raises:
        ParameterError: The node is the host's own or none, a number is not positive, not finite
            or does not fit into the drive's.
    """
    if not 1 <= settings.node < MASTER:
        reason = f"drives are 1 to {MASTER - 1}, this host is {MASTER}"
        raise ParameterError("can.nodes", settings.node, reason)
    for name in ("period", "counts", "velocity_scale", "torque_constant", "feedback_timeout"):
        if not 0.0 < (value := getattr(settings, name)) < math.inf:
            raise ParameterError(f"can.{name}", value, "it must be positive and finite")
    for name in ("max_speed", "max_torque"):
        if not (value := getattr(settings, name)) > 0.0:
            raise ParameterError(f"can.{name}", value, "it must be positive")
    if not 0.0 <= settings.rated_torque < math.inf:
        raise ParameterError("can.rated_torque", settings.rated_torque, "it must be finite, >= 0")
    numbers(settings)


def numbers(settings: AxisSettings) -> Numbers:
    """Turn settings into the drive's units.

    Raises:
        ParameterError: One of them does not fit; a time of 0 would switch its watchdog off.
    """
    ramp = settings.quick_stop_deceleration / math.tau * settings.velocity_scale
    cycle, exponent = _cycle(settings.period)
    return Numbers(
        MASTER << 16 | _integer("heartbeat_timeout", 1e3 * settings.heartbeat_timeout, 0xFFFF),
        _integer("drive_heartbeat", 1e3 * settings.drive_heartbeat, 0xFFFF),
        _integer("quick_stop_deceleration", ramp, 0xFFFF_FFFF),
        cycle,
        exponent,
    )


def _integer(name: str, value: float, high: int) -> int:
    if not (math.isfinite(value) and 1 <= round(value) <= high):
        reason = f"the drive's integer for it must be 1 to {high}"
        raise ParameterError(f"can.{name}", value, reason)
    return round(value)


def _cycle(period: float) -> tuple[int, int]:
    """Mantissa (up to 255) and power of ten of a period, the coarsest that is exact, or nearest.

    A drive interpolates over it: 33e-4 for 1/300 s is near enough.
    """
    choices = [(round(period / 10.0**e), e) for e in (-3, -4, -5, -6, -2, -1)]
    fitting = [(m, e) for m, e in choices if 1 <= m <= 255]
    if not fitting:
        raise ParameterError("can.rate", 1.0 / period, "60C2 cannot hold its period")
    return min(fitting, key=lambda c: round(abs(c[0] * 10.0 ** c[1] / period - 1.0), 6))


def setup(settings: AxisSettings) -> Steps[Abilities]:
    """Take the power off, find out what the drive can, tell it how to stop, map its PDOs.

    Setpoints and offsets are zeroed: a stale one would move the motor when it is enabled. What
    must not fail unnoticed is read back.

    Raises:
        SdoError: The drive refuses something, lacks a mode, or did not take what it was told.
    """
    told = numbers(settings)
    # First of all: it may still turn, and it may hear though its answers are lost.
    yield from attempt(CONTROLWORD, DISABLE_VOLTAGE)
    kind = yield from read(DEVICE_TYPE)
    if kind & 0xFFFF != PROFILE:
        raise SdoError(f"is no CiA 402 drive: device type {kind:08X}")
    yield from _powerless(settings)
    modes = yield from _modes(settings)
    rated_torque = settings.rated_torque or (yield from _rated_torque(settings))
    yield from write(TARGET_VELOCITY, 0)
    for entry in (TARGET_TORQUE, VELOCITY_OFFSET, TORQUE_OFFSET):
        yield from write(entry, 0, ABSENT)  # where it is needed it is mapped as well
    yield from _verified(CONSUMER_HEARTBEAT, told.consumer_heartbeat)
    yield from _verified(PRODUCER_HEARTBEAT, told.producer_heartbeat, HEARTBEAT_SHARE)
    yield from _option(QUICK_STOP_OPTION, QUICK_STOP_OPTIONS)
    yield from _verified(QUICK_STOP_DECELERATION, told.quick_stop_deceleration, SHARE)
    yield from _option(ABORT_OPTION, ABORT_OPTIONS)
    yield from attempt(FAULT_REACTION_OPTION, QUICK_STOP_ON_FAULT)
    yield from attempt(ERROR_BEHAVIOUR, STAYS_OPERATIONAL)
    yield from _tell_cycle(told)
    supply = yield from _map_all(settings, DriveMode.TORQUE in modes)
    return Abilities(modes, rated_torque, supply)


def _powerless(settings: AxisSettings) -> Steps[None]:
    for _ in range(math.ceil(POWER_PATIENCE / settings.period)):  # at most one read a tick
        word = yield from read(STATUSWORD)
        if pds_state(word) not in POWERED:
            return
    raise SdoError(f"keeps power on the motor: statusword {word:04X} after disable voltage")


def _modes(settings: AxisSettings) -> Steps[dict[DriveMode, int]]:
    """Find a mode for each need, and leave the drive in that for velocities.

    A drive may list modes that it does not take, those that it has on another field bus.
    """
    supported = yield from read(SUPPORTED_MODES)
    needed = [DriveMode.VELOCITY]
    if settings.mode is not DriveMode.VELOCITY:  # voltages are served by torques
        needed.insert(0, DriveMode.TORQUE)
    found = {}
    for need in needed:
        said = f"{SUPPORTED_MODES} is {supported:08X}"
        for name in MODES[need]:
            code = OperationMode.NAME2CODE[name]
            if not supported & OperationMode.SUPPORTED[name]:
                continue
            abort = yield from attempt(MODE, code)
            if not abort:
                found[need] = code
                break
            said += f"; SDO {MODE} = {code}: abort {abort_text(abort)}"
        else:
            lacking = " nor ".join(name.lower() for name in MODES[need])
            raise SdoError(f"takes neither {lacking} mode: {said}")
    return found


def _rated_torque(settings: AxisSettings) -> Steps[float]:
    torque = 1e-3 * (yield from read(RATED_TORQUE))
    if not settings.max_torque / PLAUSIBLE <= torque <= settings.max_torque * PLAUSIBLE:
        reason = f"{torque:g} N m, with at most {settings.max_torque:g} N m at this motor"
        raise SdoError(f"{RATED_TORQUE} is {reason}: give can.rated_torque")
    return torque


def _option(entry: Entry, choices: tuple[int, ...]) -> Steps[None]:
    """Write the first choice that is taken; without the entry the profile's default holds."""
    for option in choices:
        abort = yield from attempt(entry, option)
        if abort in ABSENT:
            return
        if not abort:
            break
    # What counts is what it says afterwards: it may have one of them for good.
    value = yield from read(entry)
    if value not in choices:
        options = " or ".join(map(str, choices))
        raise SdoError(f"{entry} stays {value}: needed is {options}")


def _tell_cycle(told: Numbers) -> Steps[None]:
    """Tell the time over which setpoints are interpolated; a drive may have none, or its own."""
    if (yield from attempt(CYCLE_EXPONENT, told.cycle_exponent)):
        answer = yield Request(CYCLE_EXPONENT)
        if answer.data is None or CYCLE_EXPONENT.unpack(answer.data) != told.cycle_exponent:
            return
    yield from attempt(CYCLE, told.cycle)


def _verified(entry: Entry, value: int, share: float = 0.0) -> Steps[None]:
    """Write an entry and read it back; it may be off by a part of the value."""
    yield from write(entry, value)
    told = yield from read(entry)
    if abs(told - value) > share * value + (1 if share else 0):
        raise SdoError(f"{entry} reads {told} after {value} was written")


def _map_all(settings: AxisSettings, torque: bool) -> Steps[Pdo | None]:
    """Map what is used and switch off the rest; return the PDO of the supply."""
    used = [RPDO_VELOCITY, TPDO_STATUS, TPDO_MOTION]
    used += [RPDO_TORQUE] if torque else []
    used += [RPDO_OFFSET] if settings.feed_forward else []
    taken = {pdo.name for pdo in used}
    spare = [Pdo(number, transmit) for number in range(1, 5) for transmit in (False, True)]
    for pdo in spare:
        if pdo.name not in taken:
            yield from _switch_off(pdo)
    for pdo in used:
        if refusal := (yield from _map(pdo, settings.node)):
            raise SdoError(refusal)
    for pdo in (TPDO_SUPPLY, TPDO_ERROR):
        if not (yield from _map(pdo, settings.node)):
            return pdo
    return None


def _switch_off(pdo: Pdo) -> Steps[None]:
    cob_id = yield from _cob_id(pdo)
    if cob_id is not None and not cob_id & UNUSED:
        # Of one that stays on nothing is used: only the bus carries it.
        yield from attempt(pdo.cob_id, cob_id | UNUSED)


def _cob_id(pdo: Pdo) -> Steps[int | None]:
    """COB-id of a PDO, or None if there is no such PDO."""
    answer = yield Request(pdo.cob_id)
    if answer.abort in ABSENT:
        return None
    return got(pdo.cob_id, answer)


def _map(pdo: Pdo, node: int) -> Steps[str]:
    """Map a PDO by the procedure of CiA 301 7.5.2.36; return why it was refused, or nothing.

    A refused one is left switched off.
    """
    before = yield from _cob_id(pdo)
    if before is None:
        return f"has no {pdo.name}"
    cob_id = before & NO_RTR | pdo.base + node
    writes = [
        (pdo.cob_id, before | UNUSED),
        (pdo.transmission, pdo.period),
        (pdo.mapping(0), 0),
        *((pdo.mapping(sub), entry.mapping) for sub, entry in enumerate(pdo.entries, 1)),
        (pdo.mapping(0), len(pdo.entries)),
        (pdo.cob_id, cob_id),
    ]
    for entry, value in writes:
        if abort := (yield from attempt(entry, value)):
            return f"SDO {entry} = {value:X}: abort {abort_text(abort)}"
    count = yield from read(pdo.mapping(0))
    told = yield from read(pdo.cob_id)
    if count != len(pdo.entries) or (told ^ cob_id) & ~NO_RTR:
        raise SdoError(f"{pdo.name} was not taken: {count} entries, COB-id {told:08X}")
    return ""
