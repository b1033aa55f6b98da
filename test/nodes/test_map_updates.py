"""`map_updates`: what obstacle_tracker sends, and what the readers of `map` make of it."""

from array import array

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.parameter import Parameter

from omniman_ros.nodes import map_messages
from omniman_ros.nodes.collision_monitor import CollisionMonitorNode
from omniman_ros.nodes.mpc_planner.node import MpcPlannerNode
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import World
from test.nodes.maps import updates_installed
from test.nodes.test_obstacle_tracker import Room, ranges_of

ROWS, COLUMNS = 20, 30


def occupied(node):
    """Return the cells of a monitor's map that are occupied."""
    return node.inputs._surroundings._map._grid.occupied


def around(t, pose):
    """A post that is put there after 1 s; the robot drives towards it."""
    return ranges_of([(2.0, -1.0, 0.1)] if t > 1.0 else [], pose)


def test_a_tracker_sends_changes_only_and_its_readers_have_its_map():
    with updates_installed(), Room(CollisionMonitorNode) as room:
        monitor = room.nodes[1]
        updates = room.listen(map_messages.OccupancyGridUpdate, map_messages.UPDATES_TOPIC)
        room.run(0.1)
        room.twist = (0.3, 0.0, 0.0)
        for second in range(4):
            room.watch(1.0, lambda t, pose, s=second: around(t + s, pose))
            room.run(0.25)
            expected = room.tracker.core.occupancy() >= 50
            assert expected.any()
            np.testing.assert_array_equal(occupied(monitor), expected)
        whole = len(room.maps)
        assert 2 <= whole <= 3, "at first, and where the map has followed the robot"
        assert len(updates) >= 15
        cells = len(room.tracker.core.map.log_odds) ** 2
        assert np.median([len(update.data) for update in updates]) < 0.7 * cells
        late = []
        room.probe.create_subscription(OccupancyGrid, "map", late.append, LATCHED)
        updates.clear()
        room.watch(0.6, lambda t, pose: around(4.0, pose))
        assert not updates, "somebody reads map only"
        assert late[-1].data == room.maps[-1].data


def test_without_map_msgs_maps_are_whole():
    with Room(CollisionMonitorNode) as room:
        room.watch(1.0, around)
        assert len(room.maps) >= 4


class Reader(World):
    """A node that reads a map of free cells, and a probe that sends updates of it."""

    def __init__(self, node):
        super().__init__(node)
        self.maps = self.publisher(OccupancyGrid, "map", LATCHED)
        kind = map_messages.OccupancyGridUpdate
        self.updates = self.publisher(kind, map_messages.UPDATES_TOPIC)

    def send_map(self, ahead=0.0):
        message = OccupancyGrid(data=[0] * (ROWS * COLUMNS))
        message.header.frame_id, message.header.stamp = "odom", self.stamp(ahead)
        message.info.width, message.info.height = COLUMNS, ROWS
        message.info.resolution, message.info.origin.orientation.w = 0.1, 1.0
        self.maps.publish(message)
        self.run(0.05)

    def send(self, age=0.0, frame="odom", stamped=True, **changes):
        given = {"x": 3, "y": 2, "width": 4, "height": 5, "data": array("b", [100] * 20)}
        message = map_messages.OccupancyGridUpdate(**(given | changes))
        message.header.frame_id = frame
        if stamped:
            message.header.stamp = self.stamp(-age)
        self.updates.publish(message)
        self.run(0.05)

    @property
    def refused(self):
        return sum(
            count for name, count in self.nodes[0].warning_counts.items() if "map_updates" in name
        )


BAD = {
    "another frame": {"frame": "map"},
    "beyond the last column": {"x": COLUMNS - 3},
    "beyond the last row": {"y": ROWS - 4},
    "before the first column": {"x": -1},
    "before the first row": {"y": -1},
    "a size that overflows": {"width": 2**31 - 1, "height": 2**31 - 1, "data": array("b", [100])},
    "too few cells": {"data": array("b", [100] * 19)},
    "no cells": {"width": 0, "height": 0, "data": array("b")},
    "an impossible value": {"data": array("b", [101] * 20)},
    "older than the map": {"age": 60.0},
    "no stamp": {"stamped": False},
    "far ahead": {"age": -60.0},
}


def test_a_reader_uses_good_updates_and_refuses_bad_ones():
    with updates_installed(), Reader(CollisionMonitorNode) as world:
        world.send()
        assert world.refused == 1, "there is no map yet"
        world.send_map()
        for count, changes in enumerate(BAD.values(), start=2):
            world.run(1.0)
            world.send(**changes)
            assert world.refused == count
            assert not occupied(world.nodes[0]).any()
        world.send()
        expected = np.zeros((ROWS, COLUMNS), dtype=bool)
        expected[2:7, 3:7] = True
        np.testing.assert_array_equal(occupied(world.nodes[0]), expected)
        world.send(age=0.2)
        assert world.refused == len(BAD) + 2, "older than the last update"


def test_a_latched_map_from_before_time_went_back_is_kept_and_updated():
    with updates_installed(), Reader(CollisionMonitorNode) as world:
        world.send_map()
        world.time -= 30.0
        world.run(0.05)
        world.send()
        assert occupied(world.nodes[0]).sum() == 20
    with updates_installed(), Reader(CollisionMonitorNode) as world:
        world.send_map(ahead=3600.0)
        assert world.nodes[0].warning_counts == {"map: stamp": 1}
        world.send()
        assert occupied(world.nodes[0]).sum() == 20


def test_the_planner_reads_updates_and_keeps_them_when_its_threshold_changes():
    with updates_installed(), Reader(MpcPlannerNode) as world:
        world.send_map()
        world.send(data=array("b", [60] * 20))
        assert world.nodes[0].core.grid.occupied.sum() == 20
        world.nodes[0].set_parameters([Parameter("map_threshold", value=61)])
        assert not world.nodes[0].core.grid.occupied.any()
