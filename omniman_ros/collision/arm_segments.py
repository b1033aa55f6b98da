"""Line segments of the arm and its tool: the axes of their capsules."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.parameters import ToolShape
from omniman_ros.collision.segments import dot
from omniman_ros.core.arm_model import JOINTS, ArmModel
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.description.transforms import transform
from omniman_ros.description.ur5 import BASE, links
from omniman_ros.motion.whole_body.model import HALF_TURN, Mount

TOOL = "tool"  #: Name of the tool among the links


@dataclass(frozen=True)
class Segments(Validated):
    """Straight line segments in base_link; the first axis holds the three coordinates."""

    start: Annotated[Array, Shape(3, ..., "S")]  #: Starts (3, ..., S) [m]
    end: Annotated[Array, Shape(3, ..., "S")]  #: Ends (3, ..., S) [m]

    def select(self, index: Indices) -> "Segments":
        """Return the segments with some indices."""
        return Segments(self.start[..., index], self.end[..., index])

    def sphere(self) -> tuple[Array, Array]:
        """Return centres (3, ...) and radii (...) [m] of spheres that contain all segments."""
        ends = np.concatenate((self.start, self.end), axis=-1)
        centre = 0.5 * (ends.min(axis=-1) + ends.max(axis=-1))
        offset = ends - centre[..., None]
        return centre, np.sqrt(dot(offset, offset).max(axis=-1))


class ArmSegments:
    """Axes of the capsules of arm and tool at given joint angles.

    A capsule around the axis of each cylinder of the description contains this cylinder.

    Attributes:
        names: Names of the links that have capsules, from the arm's base to the tool, if any.
        link: Number (S,) of the link of each capsule, the index of its name; it never decreases.
        radius: Radius (S,) of each capsule [m].
    """

    def __init__(self, mount: Mount, tool: ToolShape) -> None:
        self._model = ArmModel()
        self._base: Array = mount.pose @ HALF_TURN
        # Frames of the description and of the DH table are fixed to the same links.
        pose, frames = np.eye(4), self._model.frames(np.zeros(JOINTS))
        link, radius, ends = [], [], []
        for number, each in enumerate((BASE, *links())):
            if number > 0:
                pose = pose @ transform(each.place, each.rpy)
            offset = np.linalg.inv(frames[number]) @ pose
            for tube in each.tubes:
                link.append(number)
                radius.append(tube.radius)
                ends.append([(offset @ (*point, 1.0))[:3] for point in (tube.start, tube.end)])
        if tool.length > 0.0:
            link.append(JOINTS + 1)
            radius.append(tool.radius)
            ends.append([np.zeros(3), np.array((0.0, 0.0, tool.length))])
        described = (BASE.name, *(each.name for each in links()), TOOL)
        self.names: tuple[str, ...] = described[: link[-1] + 1]
        self.link: Indices = np.array(link)
        self.radius: Array = np.array(radius)
        self._frame = np.minimum(self.link, JOINTS)
        self._ends: Array = np.moveaxis(np.array(ends), 1, 0)
        steps = np.diff(frames[:, :3, 3], axis=0)
        self._steps: Array = np.linalg.norm(steps, axis=1)

    def extent(self, link: int) -> float:
        """Return the distance of a link's farthest point from the origin of its frame [m]."""
        ends = np.linalg.norm(self._ends, axis=-1).max(axis=0) + self.radius
        return float(ends[self.link == link].max())

    def lever_arms(self, first: int, last: int, extent: float) -> Array:
        """Return bounds (6,) of the distances of a part from the axes of the joints [m].

        They are zero for joints that do not turn the part relative to the link `first`. The part
        is fixed to the frame of the link `last`, 6 for tool and load, and `extent` is the distance
        of its farthest point from the origin of this frame [m].
        """
        result = np.zeros(JOINTS)
        for joint in range(first, last):
            result[joint] = extent + self._steps[joint:last].sum()
        return result

    def frames(self, q: Array) -> Array:
        """Return poses (..., 7, 4, 4) of base and links in base_link at joint angles (..., 6).

        Args:
            q: Joint angles (..., 6) [rad].
        """
        result: Array = self._base @ self._model.frames(q)
        return result

    def capsules(self, frames: Array) -> Segments:
        """Return the axes (3, ..., S) of the capsules at poses (..., 7, 4, 4) of the links."""
        chosen = frames[..., self._frame, :3, :]
        rotation, origin = chosen[..., :3], np.moveaxis(chosen[..., 3], -1, 0)
        start, end = (
            np.einsum("...sij,sj->i...s", rotation, points) + origin for points in self._ends
        )
        return Segments(start, end)
