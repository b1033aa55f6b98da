"""A robot with its arm as nodes, and a judge of what it touches that knows its URDF alone.

The streaming process and the arm's controller are stepped, see `SteppedArm`. The judge computes
distances by the physics engine, from the true pose and the true joint angles.
"""

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from builtin_interfaces.msg import Duration
from nav_msgs.msg import OccupancyGrid
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.nodes.arm_streamer import ArmStreamerNode
from omniman_ros.nodes.collision_monitor import CollisionMonitorNode
from omniman_ros.nodes.path_interpolator.node import PathInterpolatorNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.simulated_world import SimulatedWorldNode
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.simulation.arm_link.direct_link import DirectLink
from omniman_ros.simulation.ur.arm import SimulatedArm
from omniman_ros.simulation.ur.world_arm import WorldArm
from test.collision.reference import BOX, CYLINDER, EngineBody, Shape, description
from test.nodes.harness import World
from test.nodes.stepped_arm import SteppedArm

GAP = 0.02  #: Gap that must remain [m]
CELL = 0.05  #: Side of a cell of the map [m]
REPORT_TICKS = 20  #: Number of periods between two reports of the obstacles


@dataclass(frozen=True)
class Post:
    """A round obstacle between two heights [m]: a post, or the top of a table."""

    x: float
    y: float
    radius: float
    heights: tuple

    @property
    def shape(self):
        """What the judge sees."""
        low, high = self.heights
        place = self.x, self.y, 0.5 * (low + high)
        return Shape("", CYLINDER, (self.radius, 0.5 * (high - low)), place)

    def marker(self, number, stamp):
        """What the robot hears."""
        marker = Marker(ns="post", id=number, type=Marker.CYLINDER, action=Marker.ADD)
        marker.header.frame_id, marker.header.stamp = "odom", stamp
        place = marker.pose.position
        place.x, place.y, place.z = self.shape.position
        marker.scale.x = marker.scale.y = 2.0 * self.radius
        marker.scale.z = self.heights[1] - self.heights[0]
        marker.lifetime = Duration(sec=1)
        return marker


@dataclass(frozen=True)
class Wall:
    """A wall of cells of a map, 0.1 m thick and 6 m long, at a distance [m] in a direction [rad].

    It has no heights in the map; to the judge, it is 4 m high.
    """

    distance: float
    direction: float

    @property
    def shape(self):
        """What the judge sees."""
        middle = self.distance + CELL
        c, s = math.cos(self.direction), math.sin(self.direction)
        return Shape("", BOX, (CELL, 3.0, 2.0), (middle * c, middle * s, 2.0), self.direction)

    def map(self):
        """What the robot hears."""
        grid = OccupancyGrid()
        grid.header.frame_id = "odom"
        grid.info.resolution, grid.info.width, grid.info.height = CELL, 2, 120
        grid.data = [100] * 240
        c, s = math.cos(self.direction), math.sin(self.direction)
        place, q = grid.info.origin.position, grid.info.origin.orientation
        place.x, place.y = self.distance * c + 3.0 * s, self.distance * s - 3.0 * c
        q.z, q.w = math.sin(0.5 * self.direction), math.cos(0.5 * self.direction)
        return grid


class Judge:
    """Distances of the robot from things, by the physics engine's reading of its URDF."""

    def __init__(self, things):
        self.body = EngineBody(description(), [thing.shape for thing in things])
        model = self.body.model
        self._robot = [k for k in range(model.ngeom) if k not in self.body.extra]

    def gap(self, pose, q):
        """Return the least distance of a robot at a pose with joint angles (6,) [m]."""
        self.body.place(pose, q)
        return self.body.distance(self._robot, self.body.extra)


class _WorldEnd:
    """The arm of a simulated world on the clock of its node."""

    def __init__(self, node):
        self._node, self._servo = node, node.world.arm
        self.state, self.take_states = self._servo.state, self._servo.take_states

    def follow(self, setpoint):
        self._servo.follow(replace(setpoint, due=self._node.drives.elapsed(setpoint.due)))


class WholeRobot(World):
    """Drives, controller, interpolator, arm and monitor among things that stand.

    Args:
        posture: Joint angles (6,) at first [rad].
        things: Posts and walls that the robot hears of from the beginning.
        is_in_world: Whether it is simulated by the physics engine, in an empty scene.

    Attributes:
        drive, controller, interpolator, monitor, streamer: The nodes.
        gaps: True distance from the nearest thing in each period [m].
    """

    def __init__(self, posture, things=(), is_in_world=False):
        self._posture, self._is_in_world = tuple(posture), is_in_world
        parameters = {"collision_monitor.use": True, "simulated_controller": True}
        makers = [SimulatedDriveNode]
        if is_in_world:
            start = {"world.wheels": "ideal", "world.posture": list(posture)}
            parameters |= {"scene": "empty"} | start
            makers = [SimulatedWorldNode]
        makers += [PlatformControllerNode, PathInterpolatorNode, CollisionMonitorNode]
        self.arm = None
        super().__init__(*makers, self._make_streamer, parameters=parameters)
        self.drive, self.controller, self.interpolator, self.monitor, self.streamer = self.nodes
        self._markers = self.publisher(MarkerArray, "obstacles")
        self.gaps = []
        self._ticks = itertools.count()
        self.show(things)
        self.hooks.append(self._each_period)
        self.run_until(lambda: self.streamer.is_active, 5.0, "the arm")
        self.run(0.3)
        assert self.monitor.inputs.sees_arm

    def _make_streamer(self, **options):
        body = self._body if self._is_in_world else SimulatedArm
        self.arm = SteppedArm(make_body=body, initial=self._posture)
        self.arm.pass_time = self._pass_time
        return ArmStreamerNode(start_process=self.arm.start_process, **options)

    def _body(self, parameters):
        (world,) = (node for node in self.nodes if isinstance(node, SimulatedWorldNode))
        body = WorldArm(parameters, DirectLink(_WorldEnd(world)), is_lockstep=False)
        body.measure(self.time)  # connects
        return body

    def _pass_time(self, seconds):
        self.time += seconds
        for node in [*self.nodes, self.probe]:
            self._set_time(node)
        self.nodes[0].tick()  # the joints may be in the world
        self.arm.advance(self.time)

    def close(self):
        """End the streaming process, which would wait for time to pass, and then the nodes."""
        if self.arm is not None and self.arm.process is not None:
            self.arm.process.kill()
        super().close()

    def show(self, things):
        """Have these things around the robot from now on."""
        self.things, self._judge = tuple(things), Judge(things) if things else None
        for thing in things:
            if isinstance(thing, Wall):
                self._maps.publish(thing.map())
        self._report()

    @cached_property
    def _maps(self):
        """The publisher of maps: who has one is expected to publish."""
        return self.publisher(OccupancyGrid, "map", LATCHED)

    def _report(self):
        """Publish the posts."""
        posts = [thing for thing in self.things if isinstance(thing, Post)]
        stamp = self.stamp()
        markers = [post.marker(number, stamp) for number, post in enumerate(posts)]
        self._markers.publish(MarkerArray(markers=markers))

    def _each_period(self):
        self.arm.advance(self.time)
        if next(self._ticks) % REPORT_TICKS == 0:
            self._report()
        if self._judge is not None:
            self.gaps.append(self._judge.gap(self.pose, self.angles))

    @property
    def pose(self):
        """True pose of base_link [m, m, rad]."""
        return self.drive.drives.ground_truth()[0]

    @property
    def angles(self):
        """True joint angles (6,) [rad]."""
        return self.drive.world.arm.positions if self._is_in_world else self.arm.place

    @property
    def speeds(self):
        """Speed of the platform [m/s], its yaw rate [rad/s], and that of the fastest joint."""
        twist = self.controller.core.setpoint
        return float(np.hypot(*twist[:2])), abs(float(twist[2])), self.arm.speed
