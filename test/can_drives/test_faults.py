"""Every fault has a bounded reaction time, a stated reason and no motion afterwards.

Both sides run on injected time. The drives are `simulation.can_drives`, which shares no code with
the bridge.
"""

import math
import re

import numpy as np
import pytest

from omniman_ros.can_drives.drives import CanDrivesPhase
from omniman_ros.can_drives.wheel_feedback import MIN_INTEGRATED_ANGLE
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from test.can_drives.rig import SPEED, STEP, Rig
from test.tiers import combinations

PROTOCOLS = ("cia402", "vesc", "odrive")
WHEEL = "front_right"


def silence(rig):
    """Longest time from the last report to the stop: missed periods, one tick and a step."""
    p = rig.parameters
    return p.feedback_timeout + (p.feedback_period or p.period) + p.period + 2 * STEP


def unmoved(rig):
    """Longest time until an encoder that stands is dead: its travel, and three reports."""
    speed = abs(SPEED[rig.names.index(WHEEL)])
    period = rig.parameters.feedback_period or rig.parameters.period
    return MIN_INTEGRATED_ANGLE / speed + 3 * period


def at_reception(rig):
    """Longest time from the report of a fault to the stop on the bus."""
    return rig.parameters.period + 2e-3


def ramp(rig):
    """Return the time to rest at the deceleration limit, plus a margin for the loops."""
    return SPEED.max() / rig.parameters.quick_stop_deceleration + 0.35


FAULTS = [
    # protocol, fault, stop reason, latest time of the stop after the fault was switched on [s]
    ("cia402", {"fault": (WHEEL,)}, f"{WHEEL}: EMCY 2310", 0.02),
    ("cia402", {"reboot": (WHEEL,)}, f"{WHEEL}: (restarted|no feedback)", 0.2),
    ("cia402", {"silent": (WHEEL,)}, f"{WHEEL}: no feedback for \\d+ ms", silence),
    (
        "cia402",
        {"silent": ("front_left", WHEEL, "rear_left", "rear_right")},
        "front_left: no feedback",
        silence,
    ),
    ("cia402", {"frozen_reports": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("cia402", {"short_reports": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("cia402", {"no_heartbeat": (WHEEL,)}, f"{WHEEL}: heartbeat lost", 0.15),
    ("cia402", {"frozen_encoder": (WHEEL,)}, f"{WHEEL}: its encoder moved 0", unmoved),
    ("cia402", {"supply": 8.0}, "front_left: EMCY 3220", 0.05),
    ("vesc", {"silent": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("vesc", {"frozen_reports": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("vesc", {"short_reports": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("vesc", {"frozen_encoder": (WHEEL,)}, f"{WHEEL}: its encoder moved 0", unmoved),
    ("vesc", {"reboot": (WHEEL,)}, f"{WHEEL}: (it restarted|no feedback)", 0.2),
    ("odrive", {"silent": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("odrive", {"frozen_reports": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("odrive", {"short_reports": (WHEEL,)}, f"{WHEEL}: no feedback", silence),
    ("odrive", {"no_heartbeat": (WHEEL,)}, f"{WHEEL}: its heartbeat is missing", 0.15),
    ("odrive", {"frozen_encoder": (WHEEL,)}, f"{WHEEL}: its encoder moved 0", unmoved),
    ("odrive", {"fault": (WHEEL,)}, f"{WHEEL}: axis error", 0.1),
    ("odrive", {"reboot": (WHEEL,)}, f"{WHEEL}: (it |no feedback)", 0.2),
]


#: Faults whose reaction does not depend on the protocol: the suite plays them with cia402 only
SAME_REACTION = ("frozen_reports", "short_reports")


def fault_cases():
    for i, (protocol, fault, reason, latest) in enumerate(FAULTS):
        repeats = protocol != "cia402" and set(fault) <= set(SAME_REACTION)
        yield pytest.param(
            protocol,
            fault,
            reason,
            latest,
            marks=[pytest.mark.exhaustive] if repeats else [],
            id=f"{protocol}-{'-'.join(fault)}-{i}",
        )


@pytest.mark.parametrize(("protocol", "fault", "reason", "latest"), fault_cases())
def test_one_wheel_lost_stops_all_in_bounded_time_until_a_reset(protocol, fault, reason, latest):
    rig = Rig(protocol).driving()
    start = len(rig.speeds)
    rig.set_faults(**fault)
    after = rig.stopped_after()
    assert after <= (latest(rig) if callable(latest) else latest)
    assert re.match(reason, rig.drives.stop_reason), rig.drives.stop_reason
    coasting = {WHEEL} & set(sum((v for v in fault.values() if isinstance(v, tuple)), ()))
    others = [k for k, name in enumerate(rig.names) if name not in coasting]
    rig.until(lambda: all(abs(rig.speeds[-1][k]) < 0.05 for k in others), ramp(rig))
    steepest = np.abs(np.diff(np.array(rig.speeds[start:])[:, others][::20], axis=0)).max() / 0.02
    assert steepest <= 1.5 * rig.parameters.quick_stop_deceleration
    # the fault goes away, commands go on: nothing moves
    rig.set_faults(**{k: 0.0 if k == "supply" else () for k in fault})
    rig.run(1.0)
    quiet = np.abs(np.array(rig.speeds[-500:]))[:, others]
    assert quiet.max() < 0.05
    # an explicit reset moves nothing either, and then it drives
    rig.command = None
    rig.until(lambda: rig.drives.at_rest(rig.now))
    rig.drives.reset(rig.now)
    rig.until(lambda: rig.drives.phase is CanDrivesPhase.DRIVING, 3.0)
    rig.run(0.3)
    assert rig.standing
    rig.command = WheelCommand(DriveMode.VELOCITY, np.zeros(4), SPEED)
    rig.run(1.0)
    assert rig.speeds[-1] == pytest.approx(list(SPEED), abs=0.1)
    assert not rig.drives.stop_reason


def stop_sent(rig, since):
    """Time at which the last of four drives was commanded a quick stop (6040 = 2)."""
    commanded = {}
    for at, frame in rig.host:
        if at > since and frame.id & 0x780 in (0x200, 0x300) and frame.data[:2] == b"\x02\x00":
            commanded.setdefault(frame.id & 0x7F, at)
    assert len(commanded) == 4
    return max(commanded.values())


def test_emergency_is_acted_on_at_reception_within_one_sync_and_two_milliseconds():
    rig = Rig("cia402").driving()
    since = rig.now
    rig.set_faults(fault=(WHEEL,))
    rig.stopped_after()
    rig.run(0.02)
    node = rig.parameters.nodes[1]
    reported = next(at for at, frame in rig.other if at > since and frame.id == 0x080 + node)
    assert stop_sent(rig, since) - reported <= at_reception(rig)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_drives_stop_by_themselves_when_the_host_is_frozen(protocol):
    rig = Rig(protocol).driving()
    rig.frozen = True
    p = rig.parameters
    coast = 1.0 if protocol == "odrive" else 0.0  # its watchdog releases the motor
    rig.until(lambda: rig.standing, p.heartbeat_timeout + ramp(rig) + coast)
    rig.frozen = False
    rig.run(1.0)
    assert rig.standing, "awake again, and commanded: nothing moves"
    assert re.match("the bridge was held up|another|front_left", rig.drives.stop_reason)
    rig.command = None
    rig.until(lambda: rig.drives.at_rest(rig.now), rig.drives.longest_stop + 0.5)
    rig.drives.reset(rig.now)
    rig.until(lambda: rig.drives.phase is CanDrivesPhase.DRIVING)
    rig.command = WheelCommand(DriveMode.VELOCITY, np.zeros(4), SPEED)
    rig.run(1.0)
    assert rig.speeds[-1] == pytest.approx(list(SPEED), abs=0.2), rig.say()


@pytest.mark.parametrize("fault", ["duplicated_reports", "reordered_reports"])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_reordered_or_duplicated_reports_are_tolerated(protocol, fault):
    rig = Rig(protocol).driving()
    rig.set_faults(**{fault: (WHEEL,)})
    rig.run(0.5)
    assert not rig.drives.stop_reason
    assert rig.fastest == pytest.approx(SPEED.max(), abs=0.2)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_one_lost_frame_in_a_hundred_is_tolerated(protocol):
    rig = Rig(protocol, missed_periods=5).driving()
    rig.set_faults(lost_frames=0.01)
    rig.run(1.0)
    assert not rig.drives.stop_reason, rig.say()


@pytest.mark.parametrize(
    ("protocol", "fault"),
    [
        ("cia402", "refuse_enable"),
        ("cia402", "wrong_mode"),
        ("cia402", "stuck_status"),
        ("odrive", "refuse_enable"),
        ("odrive", "stuck_status"),
    ],
)
def test_drive_that_is_not_enabled_keeps_all_at_zero_and_is_named(protocol, fault):
    rig = Rig(protocol)
    rig.run(0.05)
    rig.drives.configure(rig.now)
    rig.until(lambda: rig.drives.phase is CanDrivesPhase.IDLE)
    rig.set_faults(**{fault: (WHEEL,)})
    rig.command = WheelCommand(DriveMode.VELOCITY, np.zeros(4), SPEED)
    rig.drives.enable(rig.now)
    rig.stopped_after(rig.parameters.enable_timeout + 0.5)
    assert WHEEL in rig.drives.stop_reason
    assert np.abs(rig.speeds).max() < 0.05


def test_stuck_status_under_way_does_not_hide_that_the_others_stop():
    rig = Rig("cia402").driving()
    rig.set_faults(stuck_status=(WHEEL,))
    rig.run(0.2)
    rig.send(rig.drives.stop("~/stop", rig.now), rig.now)
    rig.until(lambda: rig.standing, ramp(rig))


@pytest.mark.parametrize(
    ("protocol", "mode"), combinations(PROTOCOLS, ["torque", "voltage", "velocity"])
)
def test_every_mode_moves_the_wheels_and_its_silence_ramps_them_down(protocol, mode):
    rig = Rig(protocol, mode=mode).up()
    value = {"velocity": 4.0, "torque": 1.0, "voltage": 6.0}[mode]
    values = np.full(4, value)
    if mode == "velocity":
        rig.command = WheelCommand(DriveMode.VELOCITY, np.zeros(4), values)
    else:
        rig.command = WheelCommand(DriveMode(mode), values)
    rig.until(lambda: min(rig.speeds[-1]) > 2.0)
    speed = rig.fastest
    rig.command = None
    p = rig.parameters
    rig.until(lambda: rig.standing, p.command_timeout + speed / p.deceleration + 0.6)
    assert not rig.drives.stop_reason
    rig.command = WheelCommand(DriveMode.VELOCITY, np.zeros(4), SPEED)
    rig.run(1.0)
    assert rig.speeds[-1] == pytest.approx(list(SPEED), abs=0.2), "and it moves again"


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_measurements_match_the_plant(protocol):
    rig = Rig(protocol).driving(np.array([4.0, -3.0, 2.0, -1.0]))
    first = rig.drives.take_states()
    wheels = rig.bus.wheels
    before = np.array([wheels.position(k) for k in range(4)])
    rig.run(1.0)
    states = rig.drives.take_states()
    after = np.array([wheels.position(k) for k in range(4)])
    assert states.velocity == pytest.approx([4.0, -3.0, 2.0, -1.0], abs=0.15)
    assert states.position - first.position == pytest.approx(after - before, abs=0.1)
    assert (states.effort * states.velocity > 0.0).all(), "the motors overcome friction"
    table = rig.drives.electrical(0.02)
    assert np.isfinite(table).all()
    assert math.copysign(1.0, table[0, 0]) == 1.0
    assert math.copysign(1.0, table[1, 0]) == -1.0
