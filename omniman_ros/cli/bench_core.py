"""CPU time of a tick of the platform controller's core, without ROS."""

import math
import statistics
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from omniman_ros.core.arbiter import Source
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import PlatformController
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.wheel_cascade import DriveMode

PERIOD = 0.005
WARM_UP = 200
"""Ticks before the first that counts."""


def tick_time(parameters: PlatformParameters, blocks: int, block: int) -> float:
    """CPU time of hear_wheels, hear_twist and tick together [s]: the median of some blocks.

    The twist changes all the time; the wheels turn as they were told to in the tick before.

    Args:
        parameters: Of the controller.
        blocks: Number of blocks.
        block: Ticks in each.

    Raises:
        RuntimeError: The controller stopped or somebody else drove: that would not be a tick.
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
            core.hear_wheels(now, now, position, speed, core.cascade.asked)
            core.hear_twist(twists[k % block], now)
            core.tick(now)
        times.append((time.process_time() - before) / length)
    if core.arbiter.active is not Source.CMD_VEL or not core.latch.released:
        raise RuntimeError(f"the controller did not drive: {core.latch.status}")
    return statistics.median(times[1:])


def core_ticks(robot: Mapping[str, Any], blocks: int, block: int) -> dict[str, float]:
    """Microseconds of a tick in each drive mode.

    Args:
        robot: Parameters of the robot.
        blocks, block: See :func:`tick_time`.
    """
    base = build(PlatformParameters, robot)
    return {
        mode.value: 1e6
        * tick_time(replace(base, drive=replace(base.drive, mode=mode.value)), blocks, block)
        for mode in DriveMode
        if mode.value in base.drive.offered
    }
