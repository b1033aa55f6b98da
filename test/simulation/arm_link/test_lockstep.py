"""World and controller on simulated time, with sockets and a thread that is held up at random."""

import random
import time
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.simulation.arm_link.server import ArmLinkServer
from omniman_ros.simulation.ur.arm import UrArmParameters
from omniman_ros.simulation.ur.controller_clock import SimulatedTime
from omniman_ros.simulation.ur.controller_server import ControllerServer
from omniman_ros.simulation.ur.port_parameters import UrPortParameters
from test.simulation.world.support import ideal

pytestmark = pytest.mark.processes  # the controller runs in a thread

START = 100.0
STEP = 0.005  #: Step of simulated time, as on /clock [s]
LOOKAHEAD = 0.01  #: How far simulated time may be ahead of the controller's cycles [s]
TIMEOUT = 20.0
PORTS = UrPortParameters(dashboard=0, primary=0, secondary=0, realtime=0, rtde=0)
PROGRAM = "def f():\n  movej([0.4, -1.3, 1.2, -1.2, -1.3, 0.3], a=8, v=2)\nend\n"


def until(condition):
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.0005)


def track(seed):
    """Return the joints at each step, and what the controller knows in each cycle of a motion.

    Args:
        seed: Seed of the delays of world and controller; None for no delays.
    """
    rng = random.Random(seed)
    bench = ideal("omniman")
    arm, server = bench.world.arm, ArmLinkServer(0)
    pace = SimulatedTime()
    pace.set(START)
    parameters = UrArmParameters(payload=2.0, world_port=server.port)
    controller = ControllerServer(parameters, PORTS, pace)
    run_cycle = controller.cycle

    def cycle(now, due_cycles=1):
        if seed is not None:
            time.sleep(rng.choice((0.0, 0.0, 0.012)))
        run_cycle(now, due_cycles)
        measured.append((now, controller.controller.arm.q))

    controller.cycle = cycle
    rows, measured, covered, steps = [], [], START + STEP, 0
    try:
        controller.start()
        until(server.accept)
        server.send(arm.state())
        until(lambda: controller.done > START)
        while len(rows) < 100:
            for setpoint in server.receive():
                arm.follow(replace(setpoint, due=setpoint.due - START))
                covered = setpoint.due
            for state in arm.take_states():
                server.send(state)
            now = START + (steps + 1) * STEP
            until_time = min(pace.now(), controller.done) + LOOKAHEAD
            if now > until_time or (covered < now and controller.controller.arm.is_connected):
                time.sleep(0.0002)
                continue
            if seed is not None:
                time.sleep(rng.choice((0.0, 0.0, 0.012)))
            steps += 1
            pace.set(now)
            bench.wait(STEP)
            if steps == 40:
                for state in arm.take_states():
                    server.send(state)
                until(lambda: controller.done > pace.now())
                assert controller.controller.start(PROGRAM)
            if steps > 40:
                rows.append(np.concatenate((arm.positions, arm.velocities, arm.torques)))
    finally:
        controller.close()
        server.close()
    begin = START + 40 * STEP
    known = [q for now, q in measured if begin < now < begin + 90 * STEP]
    return np.array(rows), np.array(known)


def test_delays_of_world_and_controller_change_nothing():
    expected, expected_known = track(None)
    assert np.ptp(expected[:, 0]) > 0.3
    joints, known = track(1)
    np.testing.assert_array_equal(joints, expected)
    np.testing.assert_array_equal(known, expected_known)
