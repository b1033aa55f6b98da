"""The handle by which the tool is led, and the poses of its path."""

import time
from collections.abc import Callable

import numpy as np
import viser

from omniman_ros.viewer.events import ToolHandleMoved
from omniman_ros.viewer.page.inputs import Post
from omniman_ros.viewer.tool_goal import ToolGoal, ToolPose

SCALE = 0.35  #: Length of the handle's arrows [m]
AXES_LENGTH, AXES_RADIUS = 0.12, 0.006  #: Size of the axes that show a pose of the path [m]
DRAG_TIMEOUT = 0.5  #: Silence of a drag after which the handle is drawn where the node has it [s]


class ToolHandle:
    """Arrows, planes and rings that are dragged to move and to turn the tool's goal."""

    def __init__(
        self,
        api: viser.SceneApi,
        root: str,
        post: Post,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._api, self._clock = api, clock
        self._axes_name = f"{root}/tool_poses"
        self._axes: viser.BatchedAxesHandle | None = None
        self._poses: tuple[ToolPose, ...] = ()
        self._drawn: ToolPose | None = None
        self._dragged_at = -np.inf
        self._handle = api.add_transform_controls(
            f"{root}/tool_handle", scale=SCALE, depth_test=False, visible=False
        )

        @self._handle.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            if event.client_id is None:
                return
            self._dragged_at = self._clock()
            x, y, z = event.target.position.tolist()
            w, i, j, k = event.target.wxyz.tolist()
            post(ToolHandleMoved((x, y, z), (w, i, j, k)))

    def draw(self, goal: ToolGoal) -> None:
        """Draw the handle and the poses of the path."""
        pose = goal.handle
        if pose is None or self._clock() - self._dragged_at > DRAG_TIMEOUT:
            self._place(pose)
        if goal.poses != self._poses:
            self._poses = goal.poses
            self._draw_poses()

    def _place(self, pose: ToolPose | None) -> None:
        if pose == self._drawn and self._dragged_at == -np.inf:
            return
        self._drawn, self._dragged_at = pose, -np.inf
        if pose is not None:
            self._handle.position = np.array(pose.position)
            self._handle.wxyz = np.array(pose.rotation)
        self._handle.visible = pose is not None

    def _draw_poses(self) -> None:
        if self._axes is not None:
            self._axes.remove()
            self._axes = None
        if self._poses:
            self._axes = self._api.add_batched_axes(
                self._axes_name,
                np.array([pose.rotation for pose in self._poses]),
                np.array([pose.position for pose in self._poses]),
                axes_length=AXES_LENGTH,
                axes_radius=AXES_RADIUS,
            )
