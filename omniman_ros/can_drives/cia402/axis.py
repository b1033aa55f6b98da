"""Codec of a drive that speaks CiA 402 over CANopen.

Sources: CiA 301 (communication) and IEC 61800-7-201 (profile). Velocities are followed in cyclic
synchronous velocity mode or, if the drive lacks it, in profile velocity mode with the drive's own
ramps; torques in the corresponding torque modes.
"""

import math
from collections.abc import Collection

from omniman_ros.can_drives.axis import (
    AxisSettings,
    AxisState,
    Demand,
    DriveAxis,
    DriveSetpoint,
    WrappingCounter,
)
from omniman_ros.can_drives.cia402.bringup import RETRY_PERIOD, BringUp
from omniman_ros.can_drives.cia402.canopen import (
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
from omniman_ros.can_drives.cia402.drive_supervisor import DriveSupervisor, FaultReasons
from omniman_ros.can_drives.cia402.network import CanopenNetwork
from omniman_ros.can_drives.cia402.objects import (
    CONTROLWORD,
    RPDO_OFFSET,
    RPDO_TORQUE,
    RPDO_VELOCITY,
    TPDO_MOTION,
    TPDO_STATUS,
    PdoMapping,
    Units,
)
from omniman_ros.can_drives.cia402.setup import Abilities, check_settings
from omniman_ros.can_drives.cia402.state import (
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
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import InputError

SETTLING_TICKS = 3  #: Number of ticks after which a drive reports the effect of a command


class Cia402Axis(DriveAxis):
    """One CiA 402 drive.

    A stop is the drive's own quick stop, in velocity mode with a target of zero: in a torque mode
    a quick stop may be a torque of zero, which lets the motor coast.

    A drive that no longer accepts process data (another NMT state, no heartbeat, no statusword) is
    OFFLINE: it must be configured again, as it may have lost its configuration unnoticed. It is
    still commanded to stop, by PDO and, because it may not accept that, by SDO.
    """

    network = CanopenNetwork

    def __init__(self, settings: AxisSettings) -> None:
        check_settings(settings)
        self._is_mapped = False  # whether its PDOs have the mapping of this axis
        handlers = {
            EMCY: self._on_emergency,
            HEARTBEAT: self._on_heartbeat,
            SDO_ANSWER: self._on_sdo,
            TPDO[0]: self._on_status,
            TPDO[1]: self._on_motion,
            TPDO[2]: self._on_supply,
            TPDO[3]: lambda data, now: not self._is_mapped,
        }
        super().__init__(
            settings,
            [base + settings.node for base in (*RPDO, SDO_REQUEST)],
            {base + settings.node: handler for base, handler in handlers.items()},
        )
        self.modes: Collection[DriveMode] = frozenset()
        self._counter, self._reasons, self._watch = (
            WrappingCounter(),
            FaultReasons(),
            DriveSupervisor(settings),
        )
        self._bring_up: BringUp | None = None
        self._abilities: Abilities | None = None
        self._units = Units(settings, math.nan)
        self._is_reset_due = False
        self._forget()

    def _forget(self) -> None:
        self._watch.begin()
        self._nmt: NmtState | None = None
        self._sdo_sent_at = -math.inf
        self._pds: PdsState | None = None
        self._mode_shown = self._mode_requested = self._error = 0
        self._enabled_ticks = self._drive_ticks = 0
        self._is_in_mode = False
        self._reset: FaultReset | None = None

    def configure(self, now: float) -> None:
        """See `DriveAxis`: NMT pre-operational, SDOs one at a time, NMT start, first reports."""
        if self._watch.loss(now):
            self._restart_counter()  # the drive may have restarted unnoticed
        self._clear()
        self._is_reset_due = False
        self._begin()

    def _begin(self) -> None:
        self._forget()
        self.state = AxisState.CONFIGURING
        self._is_mapped, self.modes = False, frozenset()
        self._bring_up = BringUp(self.settings)

    def reset(self, now: float) -> None:
        """See `DriveAxis`."""
        self._clear()
        if self._is_configured:
            if self._pds in FAULTS:
                self._reset = FaultReset(now, self.settings.period)
        elif self._bring_up is not None:
            if self.state is AxisState.OFFLINE:
                self._begin()
            self._is_reset_due = True

    @property
    def _is_configured(self) -> bool:
        return self.state not in (AxisState.OFFLINE, AxisState.CONFIGURING)

    def _clear(self) -> None:
        self._reasons.clear()
        self._watch.excuse()
        self.fault_reason = ""

    def _fail(self, kind: str, reason: str) -> None:
        self._reasons.add(kind, reason)
        self.fault_reason = str(self._reasons)

    def _lose(self, kind: str, reason: str) -> None:
        """Record a reason for which the drive must be configured again."""
        self._fail(kind, reason)
        self.state = AxisState.OFFLINE
        self._is_in_mode, self._reset = False, None

    # ---- reception ----------------------------------------------------------------------------

    def _on_emergency(self, data: bytes, now: float) -> bool:
        message = parse_emergency(data)
        if message is not None and message.code:
            self._fail(f"EMCY {message.code}", str(message))
        return message is not None

    def _on_heartbeat(self, data: bytes, now: float) -> bool:
        state = parse_heartbeat(data)
        if state is None:
            return False
        self._nmt = state
        self._watch.heartbeat(now)
        if state is NmtState.BOOT_UP:
            self._on_restart()
        elif self._is_configured and state is not NmtState.OPERATIONAL:
            self._lose("NMT", f"left operational by itself: heartbeat reports {state}")
        return True

    def _restart_counter(self) -> None:
        self._counter.restart()
        self.feedback.restarts += 1

    def _on_restart(self) -> None:
        self._restart_counter()
        self._is_mapped = False
        if self.state is AxisState.CONFIGURING:
            self._begin()
        elif self._abilities is not None:
            self._lose("boot-up", "restarted (boot-up)")

    def _on_sdo(self, data: bytes, now: float) -> bool:
        if self.state is AxisState.CONFIGURING and self._bring_up is not None:
            is_answer = self._bring_up.receive(data)
            self._follow_bring_up()
            return is_answer
        answer = parse_sdo(data)  # answers a controlword of `_frames_offline`
        return (
            answer is not None
            and self.state is AxisState.OFFLINE
            and self._abilities is not None
            and (answer.index, answer.sub) == (CONTROLWORD.index, CONTROLWORD.sub)
        )

    def _on_status(self, data: bytes, now: float) -> bool:
        if not self._is_mapped:
            return True  # the data have another mapping
        values = TPDO_STATUS.unpack(data)
        if values is None:
            return False
        word, mode, torque = values
        state = pds_state(word)
        if state is None:
            return False
        previous, self._pds, self._mode_shown = self._pds, state, mode
        self._watch.status(now)
        self.feedback.torque = self._units.torque(torque)
        self.feedback.current = self.feedback.torque / self.settings.torque_constant
        self._run_if_ready(now)
        if self._is_configured:
            self._evaluate(previous, word)
        return True

    def _on_motion(self, data: bytes, now: float) -> bool:
        if not self._is_mapped:
            return True
        values = TPDO_MOTION.unpack(data)
        if values is None:
            return False
        position, velocity = values
        angle = self._units.position(self._counter.update(position))
        self.feedback.measure(angle, self._units.velocity(velocity), now)
        return True

    def _on_supply(self, data: bytes, now: float) -> bool:
        if not self._is_mapped or self._abilities is None:
            return True
        supply = self._abilities.supply
        values = None if supply is None else supply.unpack(data)
        if values is None:
            return False
        self._error = values[0]
        if len(values) > 1:
            self.feedback.bus_voltage = 1e-3 * values[1]
        self._report_error()
        return True

    def _report_error(self) -> None:
        # Object 603F (error code) keeps the last error, even after the error has gone.
        if self._error and "fault" in self._reasons:
            self._fail("error", f"error code {error_text(self._error)}")

    def _run_if_ready(self, now: float) -> None:
        """Leave CONFIGURING at the first statusword after the first heartbeat since the start."""
        if self.state is not AxisState.CONFIGURING or self._nmt is not NmtState.OPERATIONAL:
            return
        assert self._pds is not None
        if self._is_reset_due and self._pds in FAULTS:
            self._reset = FaultReset(now, self.settings.period)
        self._is_reset_due = False
        self._update_state(self._pds)

    def _evaluate(self, previous: PdsState | None, word: int) -> None:
        """Detect faults and lost power in a new statusword, and update the state."""
        state = self._pds
        assert state is not None
        if state in FAULTS:
            if self._reset is None:
                self._fail("fault", f"{state}, statusword {word:04X}")
                self._report_error()
        else:
            self._reset = None
            has_left = previous is PdsState.ENABLED and state is not PdsState.ENABLED
            if has_left and self._enabled_ticks >= SETTLING_TICKS:
                event = "stops by itself" if state in POWERED else "lost its power stage"
                self._fail("left", f"{event}: {state}")
        self._update_state(state)

    def _update_state(self, state: PdsState) -> None:
        matches = self._is_in_mode or self._mode_shown == self._mode_requested
        self._is_in_mode = state is PdsState.ENABLED and matches
        self.state = AXIS_STATES[state]
        if state is PdsState.ENABLED and not self._is_in_mode:
            self.state = AxisState.READY  # until it is in the requested mode

    # ---- sending ------------------------------------------------------------------------------

    def frames(self, demand: Demand, setpoint: DriveSetpoint, now: float) -> list[CanFrame]:
        """See `DriveAxis`. With a fault reason, DRIVE is treated as STOP.

        Raises:
            InputError: The drive does not support the mode of the setpoint.
        """
        if self.state is AxisState.CONFIGURING:
            return self._frames_configuring(now)
        if self._is_configured:
            self._supervise(demand, now)
        if self._is_configured:
            return self._frames_running(demand, setpoint, now)
        return self._frames_offline(demand, now)

    def _frames_configuring(self, now: float) -> list[CanFrame]:
        assert self._bring_up is not None
        frames = self._bring_up.tick(self._nmt, now)
        self._follow_bring_up()
        return frames

    def _follow_bring_up(self) -> None:
        assert self._bring_up is not None
        abilities = self._bring_up.abilities
        if self._bring_up.failure:
            self._lose("configuration", self._bring_up.failure)
        elif abilities is not None and not self._is_mapped:
            self._abilities, self._is_mapped = abilities, True
            self._units = Units(self.settings, abilities.rated_torque)
            self.modes = frozenset(abilities.modes)
            self._mode_requested = abilities.modes[DriveMode.VELOCITY]
            self._nmt = None  # only heartbeats from now on are evaluated

    def _frames_offline(self, demand: Demand, now: float) -> list[CanFrame]:
        if self._abilities is None:
            return []
        word = DISABLE_VOLTAGE if demand is Demand.IDLE else QUICK_STOP
        frames = [self._frame(RPDO_VELOCITY, word, 0, self._abilities.modes[DriveMode.VELOCITY])]
        if now - self._sdo_sent_at >= RETRY_PERIOD:
            self._sdo_sent_at = now
            frames.append(download(self.settings.node, CONTROLWORD, word))
        return frames

    def _supervise(self, demand: Demand, now: float) -> None:
        if loss := self._watch.loss(now):
            self._lose(*loss)
            self._restart_counter()
            return
        assert self._pds is not None
        modes = self._mode_shown, self._mode_requested
        for reason in self._watch.refusals(self._pds, demand, *modes, now):
            self._fail(*reason)

    def _frames_running(
        self, demand: Demand, setpoint: DriveSetpoint, now: float
    ) -> list[CanFrame]:
        abilities, units = self._abilities, self._units
        assert abilities is not None and self._pds is not None
        if self._reset is not None and self._reset.expired(now):
            self._reset = None
            self._fail("reset", f"{self._pds} is not reset in {FaultReset.TIMEOUT:g} s")
        if demand is Demand.DRIVE and setpoint.mode not in abilities.modes:
            raise InputError(f"{self.settings.name}: the drive has no {setpoint.mode.value} mode")
        if demand is Demand.DRIVE and self.fault_reason:
            demand = Demand.STOP
        reset = self._reset
        word = reset.controlword() if reset else CONTROLWORDS[demand][self._pds]
        drives = demand is Demand.DRIVE and word == ENABLE
        self._enabled_ticks = (
            self._enabled_ticks + 1 if drives and self._pds is PdsState.ENABLED else 0
        )
        # A drive that was commanded to stop may still report that it is enabled: if it accepts
        # "enable operation" during its quick stop, an old setpoint would accelerate it again.
        self._drive_ticks = self._drive_ticks + 1 if demand is Demand.DRIVE else 0
        self._watch.tick()
        moves = drives and self._is_in_mode and self._drive_ticks > SETTLING_TICKS
        mode = setpoint.mode if demand is Demand.DRIVE else DriveMode.VELOCITY
        self._mode_requested = abilities.modes[mode]
        value, offset = (setpoint.value, setpoint.feedforward) if moves else (0.0, 0.0)
        frames = []
        if self.settings.feed_forward:
            offset = offset if mode is DriveMode.VELOCITY else 0.0
            frames.append(self._frame(RPDO_OFFSET, units.from_torque(offset)))
        if mode is DriveMode.VELOCITY:
            target, pdo = units.from_velocity(value), RPDO_VELOCITY
        else:
            target, pdo = units.from_torque(value), RPDO_TORQUE
        return [*frames, self._frame(pdo, word, target, self._mode_requested)]

    def _frame(self, pdo: PdoMapping, *values: int) -> CanFrame:
        return CanFrame(pdo.base + self.settings.node, pdo.pack(*values))
