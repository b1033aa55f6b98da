"""A drive that speaks CiA 402 over CANopen.

CiA 301 (communication) and IEC 61800-7-201 (profile). Velocities are followed in cyclic
synchronous velocity mode or, where the drive lacks it, in profile velocity mode, with the drive's
own ramps; torques in the modes alike.
"""

import math
from collections.abc import Callable, Collection

from omniman_ros.can_drive.axis import (
    AxisSettings,
    AxisState,
    Counter,
    Demand,
    Feedback,
    Receipt,
    Setpoint,
)
from omniman_ros.can_drive.canopen import (
    EMCY,
    HEARTBEAT,
    RPDO,
    SDO_ANSWER,
    SDO_REQUEST,
    TPDO,
    NmtState,
    download,
    error_text,
    parse_emergency,
    parse_heartbeat,
    parse_sdo,
)
from omniman_ros.can_drive.cia402_bringup import RETRY, BringUp
from omniman_ros.can_drive.cia402_network import CanopenNetwork
from omniman_ros.can_drive.cia402_objects import (
    CONTROLWORD,
    RPDO_OFFSET,
    RPDO_TORQUE,
    RPDO_VELOCITY,
    TPDO_MOTION,
    TPDO_STATUS,
    Pdo,
)
from omniman_ros.can_drive.cia402_setup import Abilities, check
from omniman_ros.can_drive.cia402_state import (
    AXIS_STATES,
    CONTROLWORDS,
    DISABLE_VOLTAGE,
    ENABLE,
    FAULTS,
    POWERED,
    QUICK_STOP,
    FaultReset,
    PdsState,
    pds_state,
)
from omniman_ros.can_drive.cia402_units import Units
from omniman_ros.can_drive.cia402_watch import Troubles, Watch
from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.errors import InputError
from omniman_ros.core.wheel_cascade import DriveMode

SETTLED = 3
"""Ticks after which a drive shows what an older one told it: those of before are at an end."""

__all__ = ["CanopenNetwork", "Cia402Axis"]


class Cia402Axis:
    """One drive; see `axis.Axis`.

    A stop is the drive's own quick stop, in velocity mode with a target of zero: in a torque mode
    a quick stop may be a torque of zero, which coasts.

    A drive that does not take process data any more (another NMT state, no heartbeat, no
    statusword) is OFFLINE: it needs to be configured again, as it may have lost its configuration
    unheard. It goes on being told to stop, by PDO and, as it may not hear that, by SDO.

    Args:
        settings: Of the drive.

    Raises:
        ParameterError: See `cia402_setup.check`.
    """

    def __init__(self, settings: AxisSettings) -> None:
        node = settings.node
        check(settings)
        self.settings = settings
        self.state = AxisState.OFFLINE
        self.trouble = ""
        self.feedback = Feedback()
        self.modes: Collection[DriveMode] = frozenset()
        self.command_ids: Collection[tuple[int, bool]] = frozenset(
            (base + node, False) for base in (*RPDO, SDO_REQUEST)
        )
        self._handlers: dict[int, Callable[[bytes, float], bool]] = {
            EMCY + node: self._take_emergency,
            HEARTBEAT + node: self._take_heartbeat,
            SDO_ANSWER + node: self._take_sdo,
            TPDO[0] + node: self._take_status,
            TPDO[1] + node: self._take_motion,
            TPDO[2] + node: self._take_supply,
            TPDO[3] + node: lambda data, now: not self._mapped,
        }
        self._counter, self._troubles, self._watch = Counter(), Troubles(), Watch(settings)
        self._bring_up: BringUp | None = None
        self._abilities: Abilities | None = None
        self._units = Units(settings, math.nan)
        self._mapped = False  # whether its PDOs are as they were mapped here
        self._reset_due = False
        self._forget()

    def _forget(self) -> None:
        """Forget what the drive has said, and what was noted of it."""
        self._watch.begin()
        self._nmt: NmtState | None = None
        self._told_at = -math.inf
        self._pds: PdsState | None = None
        self._mode_shown = self._mode_asked = self._error = 0
        self._settled = self._driven = 0
        self._following = False
        self._reset: FaultReset | None = None

    def configure(self, now: float) -> None:
        """See `axis.Axis`: NMT pre-operational, SDOs one at a time, NMT start, first answers."""
        if self._watch.loss(now):
            self._counter.restart()  # it may have begun anew unheard
        self._clear()
        self._reset_due = False
        self._begin()

    def _begin(self) -> None:
        self._forget()
        self.state = AxisState.CONFIGURING
        self._mapped, self.modes = False, frozenset()
        self._bring_up = BringUp(self.settings)

    def reset(self, now: float) -> None:
        """See `axis.Axis`."""
        self._clear()
        if self._runs:
            if self._pds in FAULTS:
                self._reset = FaultReset(now, self.settings.period)
        elif self._bring_up is not None:
            if self.state is AxisState.OFFLINE:
                self._begin()
            self._reset_due = True

    @property
    def _runs(self) -> bool:
        """Whether it is configured, and as far as is known still is."""
        return self.state not in (AxisState.OFFLINE, AxisState.CONFIGURING)

    def _clear(self) -> None:
        self._troubles.clear()
        self._watch.excuse()
        self.trouble = ""

    def _fail(self, kind: str, reason: str) -> None:
        self._troubles.add(kind, reason)
        self.trouble = str(self._troubles)

    def _lose(self, kind: str, reason: str) -> None:
        """The drive needs to be configured again."""
        self._fail(kind, reason)
        self.state = AxisState.OFFLINE
        self._following, self._reset = False, None

    # Reception

    def receive(self, frame: Frame, now: float) -> Receipt:
        """See `axis.Axis`."""
        handler = None if frame.extended else self._handlers.get(frame.id)
        if handler is None:
            return Receipt.FOREIGN
        taken = not frame.remote and handler(frame.data, now)
        return Receipt.TAKEN if taken else Receipt.MALFORMED

    def _take_emergency(self, data: bytes, now: float) -> bool:
        message = parse_emergency(data)
        if message is not None and message.code:
            self._fail(f"EMCY {message.code}", str(message))
        return message is not None

    def _take_heartbeat(self, data: bytes, now: float) -> bool:
        state = parse_heartbeat(data)
        if state is None:
            return False
        self._nmt = state
        self._watch.heartbeat(now)
        if state is NmtState.BOOT_UP:
            self._begin_anew()
        elif self._runs and state is not NmtState.OPERATIONAL:
            self._lose("NMT", f"left operational by itself: heartbeat says {state}")
        return True

    def _begin_anew(self) -> None:
        self._counter.restart()
        self._mapped = False
        if self.state is AxisState.CONFIGURING:
            self._begin()
        elif self._abilities is not None:
            self._lose("boot-up", "began anew (boot-up)")

    def _take_sdo(self, data: bytes, now: float) -> bool:
        if self.state is AxisState.CONFIGURING and self._bring_up is not None:
            taken = self._bring_up.receive(data)
            self._follow_bring_up()
            return taken
        answer = parse_sdo(data)  # that to a controlword of `_frames_offline`
        return (
            answer is not None
            and self.state is AxisState.OFFLINE
            and self._abilities is not None
            and (answer.index, answer.sub) == (CONTROLWORD.index, CONTROLWORD.sub)
        )

    def _take_status(self, data: bytes, now: float) -> bool:
        if not self._mapped:
            return True  # of another mapping
        values = TPDO_STATUS.unpack(data)
        if values is None:
            return False
        word, mode, torque = values
        state = pds_state(word)
        if state is None:
            return False
        before, self._pds, self._mode_shown = self._pds, state, mode
        self._watch.status(now)
        self.feedback.torque = self._units.torque(torque)
        self.feedback.current = self.feedback.torque / self.settings.torque_constant
        self._run_if_ready(now)
        if self._runs:
            self._judge(before, word)
        return True

    def _take_motion(self, data: bytes, now: float) -> bool:
        if not self._mapped:
            return True
        values = TPDO_MOTION.unpack(data)
        if values is None:
            return False
        position, velocity = values
        feedback = self.feedback
        feedback.position = self._units.position(self._counter.update(position))
        feedback.velocity = self._units.velocity(velocity)
        feedback.at, feedback.count = now, feedback.count + 1
        return True

    def _take_supply(self, data: bytes, now: float) -> bool:
        if not self._mapped or self._abilities is None:
            return True
        supply = self._abilities.supply
        values = None if supply is None else supply.unpack(data)
        if values is None:
            return False
        self._error = values[0]
        if len(values) > 1:
            self.feedback.bus_voltage = 1e-3 * values[1]
        self._tell_error()
        return True

    def _tell_error(self) -> None:
        # 603F keeps the last error, also when it is gone.
        if self._error and "fault" in self._troubles:
            self._fail("error", f"error code {error_text(self._error)}")

    def _run_if_ready(self, now: float) -> None:
        """Leave CONFIGURING with a statusword after the first heartbeat after the start."""
        if self.state is not AxisState.CONFIGURING or self._nmt is not NmtState.OPERATIONAL:
            return
        assert self._pds is not None
        if self._reset_due and self._pds in FAULTS:
            self._reset = FaultReset(now, self.settings.period)
        self._reset_due = False
        self._update_state(self._pds)

    def _judge(self, before: PdsState | None, word: int) -> None:
        """Note what a new statusword means."""
        state = self._pds
        assert state is not None
        if state in FAULTS:
            if self._reset is None:
                self._fail("fault", f"{state}, statusword {word:04X}")
                self._tell_error()
        else:
            self._reset = None
            left = before is PdsState.ENABLED and state is not PdsState.ENABLED
            if left and self._settled >= SETTLED:
                what = "stops by itself" if state in POWERED else "lost its power stage"
                self._fail("left", f"{what}: {state}")
        self._update_state(state)

    def _update_state(self, state: PdsState) -> None:
        matches = self._following or self._mode_shown == self._mode_asked
        self._following = state is PdsState.ENABLED and matches
        self.state = AXIS_STATES[state]
        if state is PdsState.ENABLED and not self._following:
            self.state = AxisState.READY  # not before it follows what it is asked to

    # Sending

    def tick(self, demand: Demand, setpoint: Setpoint, now: float) -> list[Frame]:
        """See `axis.Axis`.

        With trouble, DRIVE is taken for STOP.

        Raises:
            InputError: The setpoint is not finite, or the drive cannot follow one of its mode.
        """
        if not (math.isfinite(setpoint.value) and math.isfinite(setpoint.feedforward)):
            raise InputError(f"{self.settings.name}: setpoint {setpoint} is not finite")
        if self.state is AxisState.CONFIGURING:
            return self._frames_configuring(now)
        if self._runs:
            self._look(demand, now)
        if self._runs:
            return self._frames_running(demand, setpoint, now)
        return self._frames_offline(demand, now)

    def _frames_configuring(self, now: float) -> list[Frame]:
        assert self._bring_up is not None
        frames = self._bring_up.tick(self._nmt, now)
        self._follow_bring_up()
        return frames

    def _follow_bring_up(self) -> None:
        assert self._bring_up is not None
        abilities = self._bring_up.abilities
        if self._bring_up.failure:
            self._lose("configuration", self._bring_up.failure)
        elif abilities is not None and not self._mapped:
            self._abilities, self._mapped = abilities, True
            self._units = Units(self.settings, abilities.rated_torque)
            self.modes = frozenset(abilities.modes)
            self._mode_asked = abilities.modes[DriveMode.VELOCITY]
            self._nmt = None  # it counts from now on

    def _frames_offline(self, demand: Demand, now: float) -> list[Frame]:
        if self._abilities is None:
            return []
        word = DISABLE_VOLTAGE if demand is Demand.IDLE else QUICK_STOP
        frames = [self._frame(RPDO_VELOCITY, word, 0, self._abilities.modes[DriveMode.VELOCITY])]
        if now - self._told_at >= RETRY:
            self._told_at = now
            frames.append(download(self.settings.node, CONTROLWORD, word))
        return frames

    def _look(self, demand: Demand, now: float) -> None:
        """Note what has not come."""
        if loss := self._watch.loss(now):
            self._lose(*loss)
            self._counter.restart()
            return
        assert self._pds is not None
        modes = self._mode_shown, self._mode_asked
        for reason in self._watch.refusals(self._pds, demand, *modes, now):
            self._fail(*reason)

    def _frames_running(self, demand: Demand, setpoint: Setpoint, now: float) -> list[Frame]:
        abilities, units = self._abilities, self._units
        assert abilities is not None and self._pds is not None
        if self._reset is not None and self._reset.expired(now):
            self._reset = None
            self._fail("reset", f"{self._pds} is not reset in {FaultReset.PATIENCE:g} s")
        if demand is Demand.DRIVE and setpoint.mode not in abilities.modes:
            raise InputError(f"{self.settings.name}: the drive has no {setpoint.mode.value} mode")
        if demand is Demand.DRIVE and self.trouble:
            demand = Demand.STOP
        reset = self._reset
        word = reset.controlword() if reset else CONTROLWORDS[demand][self._pds]
        drives = demand is Demand.DRIVE and word == ENABLE
        self._settled = self._settled + 1 if drives and self._pds is PdsState.ENABLED else 0
        # A drive that was told to stop may still show that it is enabled: where it takes "enable
        # operation" in its quick stop, an old setpoint would speed it up again.
        self._driven = self._driven + 1 if demand is Demand.DRIVE else 0
        self._watch.tick()
        moves = drives and self._following and self._driven > SETTLED
        mode = setpoint.mode if demand is Demand.DRIVE else DriveMode.VELOCITY
        self._mode_asked = abilities.modes[mode]
        value, offset = (setpoint.value, setpoint.feedforward) if moves else (0.0, 0.0)
        frames = []
        if self.settings.feed_forward:
            offset = offset if mode is DriveMode.VELOCITY else 0.0
            frames.append(self._frame(RPDO_OFFSET, units.from_torque(offset)))
        if mode is DriveMode.VELOCITY:
            target, pdo = units.from_velocity(value), RPDO_VELOCITY
        else:
            target, pdo = units.from_torque(value), RPDO_TORQUE
        return [*frames, self._frame(pdo, word, target, self._mode_asked)]

    def _frame(self, pdo: Pdo, *values: int) -> Frame:
        return Frame(pdo.base + self.settings.node, pdo.pack(*values))
