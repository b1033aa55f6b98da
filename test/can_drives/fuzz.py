"""Random frames by a seed, many of them with ids of the codec under test."""

import math
import random
from dataclasses import fields

from omniman_ros.can_drives.axis import AxisSettings, AxisState, Demand, DriveSetpoint
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode
from test.fuzz import examples

COUNT = examples(10_000)  #: Number of frames for each codec

EDGES = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\x01")


def frames(seed, count, ids, ids_extended=()):
    """Yield frames of random or extreme bytes; three of four have one of the ids."""
    chance = random.Random(seed)
    known = [(i, False) for i in ids] + [(i, True) for i in ids_extended]
    for _ in range(count):
        if known and chance.random() < 0.75:
            id, extended = chance.choice(known)
            extended ^= chance.random() < 0.02
        else:
            extended = chance.random() < 0.5
            id = chance.getrandbits(29 if extended else 11)
        length = 8 if chance.random() < 0.6 else chance.randrange(9)
        if chance.random() < 0.2:
            data = b"".join(chance.choice(EDGES) for _ in range(length))
        else:
            data = chance.randbytes(length)
        yield CanFrame(id, data, extended, chance.random() < 0.02)


def settings(**changes):
    """Return settings: node 5, 200 Hz, 4096 counts per turn, heartbeat timeout 0.1 s."""
    values = {
        "name": "front_left",
        "node": 5,
        "period": 0.005,
        "counts": 4096.0,
        "velocity_scale": 4096.0,
        "pole_pairs": 7,
        "torque_constant": 0.05,
        "rated_torque": 1.0,
        "mode": DriveMode.VELOCITY,
        "feed_forward": False,
        "max_speed": 500.0,
        "max_torque": 2.0,
        "quick_stop_deceleration": 200.0,
        "heartbeat_timeout": 0.1,
        "drive_heartbeat": 0.03,
        "feedback_timeout": 0.015,
    }
    return AxisSettings(**(values | changes))


def endure(in_state, state, given, moves):
    """Assert that no frame raises, moves a drive that is not enabled, or makes values infinite.

    Args:
        in_state: Returns an axis in a state at a time [s].
        given: COUNT frames.
        moves: Whether a frame asks for motion.
    """
    axis, idle, driven = in_state(state), 0, 0
    values = [one.name for one in fields(axis.feedback) if one.name != "at"]
    fast = DriveSetpoint(DriveMode.VELOCITY, 30.0)
    for k, frame in enumerate(given):
        now = k * 1e-4
        axis.receive(frame, now)
        assert not any(math.isinf(getattr(axis.feedback, name)) for name in values), frame
        if k % 10 == 0 or axis.state is not state:
            enabled = axis.state is AxisState.ENABLED
            sent = axis.tick(Demand.STOP if k % 20 else Demand.DRIVE, fast, now)
            assert enabled or not any(map(moves, sent)), frame
            driven, idle = driven + enabled, idle + (not enabled)
            if axis.state is not state:
                axis = in_state(state, now)
    assert idle > COUNT // 20
    assert (driven > COUNT // 20) is (state is AxisState.ENABLED)
