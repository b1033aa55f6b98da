"""Logs that are made without a recording."""

import numpy as np

from omniman_ros.recording.film.film_log import FilmLog, Series
from omniman_ros.recording.robot_log import RobotLog


def series(*pairs):
    made = Series()
    for time, value in pairs:
        made.add(time, value)
    return made


def log_of(sources, end, **fields):
    """Return the log of a robot that drives along x at 0.5 m/s, by its sources."""
    times = np.arange(0.0, end + 0.01, 0.1)
    odom = np.zeros((len(times), 7))
    odom[:, 0], odom[:, 1] = times, 0.5 * times
    return FilmLog(RobotLog(odom=odom, truth=odom.copy(), sources=sources), **fields)
