"""Measurement of the CPU time of a tick of the platform controller's core, without ROS."""

import math
import statistics
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.arbiter import Source
from omniman_ros.core.parameters import build

PERIOD = 0.005  # period of the controller [s]
WARM_UP = 200  # number of ticks that run before the measurement


def tick_time(parameters: PlatformParameters, blocks: int, block: int) -> float:
    """Return the CPU time of `update_wheels`, `set_twist` and `tick` together [s].

    It is the mean over a block of ticks, the median of all blocks. The twist changes at every
    tick; the wheels turn as commanded at the previous tick.
    """
    core = PlatformController(parameters)
    position = np.zeros(parameters.robot.wheel_count)
    twists = [
        np.array([0.3 * math.cos(k / 100), 0.3 * math.sin(k / 70), 0.3 * math.sin(k / 130)])
        for k in range(block)
    ]
    times = []
    now = 100.0
    for run in range(blocks + 1):
        length = block if run else WARM_UP
        before = time.process_time()
        for k in range(length):
            now += PERIOD
            speed = core.cascade.reference
            position = position + PERIOD * speed
            core.update_wheels(now, now, position, speed, core.cascade.demanded_torque)
            core.set_twist(twists[k % block], now)
            core.tick(now)
        times.append((time.process_time() - before) / length)
    if core.arbiter.active is not Source.CMD_VEL or not core.latch.released:
        raise RuntimeError(f"the controller did not drive: {core.latch.status}")
    return statistics.median(times[1:])


def core_ticks(robot: Mapping[str, Any], blocks: int, block: int) -> dict[str, float]:
    """Measure the CPU time of a tick in each drive mode that the robot offers.

    Returns:
        CPU times by drive mode [us].
    """
    base = build(PlatformParameters, robot)
    return {
        mode.value: 1e6
        * tick_time(replace(base, drive=replace(base.drive, mode=mode.value)), blocks, block)
        for mode in DriveMode
        if mode.value in base.drive.offered
    }
