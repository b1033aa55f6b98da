"""The messages of map_msgs for tests."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from omniman_ros.nodes import map_messages
from test import ros_interfaces


@contextmanager
def updates_installed() -> Iterator[None]:
    """Let nodes that are made within publish and receive `map_updates`."""
    with ros_interfaces.installed("map_msgs"), pytest.MonkeyPatch.context() as patch:
        from map_msgs.msg import OccupancyGridUpdate

        patch.setattr(map_messages, "OccupancyGridUpdate", OccupancyGridUpdate)
        yield
