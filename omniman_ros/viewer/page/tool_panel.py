"""Controls of the tool's goal: where its handle is, and the path that leads there."""

import math

import numpy as np
import viser

from omniman_ros.viewer.events import ButtonPressed, ToolHandleMoved
from omniman_ros.viewer.page.inputs import NumberInput, Post, add_button
from omniman_ros.viewer.page.viser_compat import row_css, style_html
from omniman_ros.viewer.status_text import hint
from omniman_ros.viewer.tool_goal import ToolPose
from omniman_ros.viewer.view_state import ViewState

MAX_COORDINATE = 1000.0  #: Largest coordinate of the handle that can be entered [m]
BUTTONS = {
    "tool_place": ("Place handle", viser.Icon.CROSSHAIR),
    "tool_add": ("Add pose", viser.Icon.PLUS),
    "tool_send": ("Lead tool", viser.Icon.PLAYER_PLAY),
    "tool_remove": ("Remove", viser.Icon.X),
}  #: Label and icon of each button, by its action


class ToolPanel:
    """Buttons, and the handle's pose in numbers, by which it is moved without a mouse."""

    def __init__(self, gui: viser.GuiApi, post: Post) -> None:
        self._post = post
        self._buttons = {
            action: add_button(
                gui,
                label,
                lambda action=action: post(ButtonPressed(action)),  # type: ignore[misc]
                "blue" if action == "tool_send" else "gray",
                icon,
            )
            for action, (label, icon) in BUTTONS.items()
        }
        self._hint = gui.add_html("")
        self._position = [
            NumberInput(gui, f"tool {axis} (m)", -MAX_COORDINATE, MAX_COORDINATE, 0.05)
            for axis in "xyz"
        ]
        self._angles = [
            NumberInput(gui, f"tool {name} (°)", -180.0, 180.0, 5.0)
            for name in ("roll", "pitch", "yaw")
        ]
        gui.add_html(style_html(row_css(self._buttons.values(), 2)))

    def draw(self, state: ViewState, now: float) -> None:
        """Display the handle, at a time on the clock of `state` [s]."""
        goal = state.tool_goal
        pose, numbers = goal.handle, (*self._position, *self._angles)
        for number in numbers:
            number.handle.disabled = pose is None
        for action in ("tool_add", "tool_send", "tool_remove"):
            self._buttons[action].disabled = pose is None
        self._buttons["tool_place"].disabled = state.tool is None
        if pose is None:
            for number in numbers:
                number.reset()
            self._hint.content = hint(
                "Place handle, drag its arrows and rings, then Lead tool."
                if state.tool is not None
                else "It is not known where the tool is."
            )
            return
        self._hint.content = hint(f"Poses before the handle: {len(goal.poses)}")
        self._draw_pose(pose, now)

    def _draw_pose(self, pose: ToolPose, now: float) -> None:
        rpy = viser.transforms.SO3(np.array(pose.rotation)).as_rpy_radians()
        degrees = [math.degrees(angle) for angle in (rpy.roll, rpy.pitch, rpy.yaw)]
        shown = [*(round(v, 3) for v in pose.position), *(round(v, 1) for v in degrees)]
        values, is_new = [*pose.position, *degrees], False
        for k, number in enumerate((*self._position, *self._angles)):
            requested = number.draw(float(shown[k]), now)
            if requested is not None:
                values[k], is_new = requested, True
        if is_new:
            turned = viser.transforms.SO3.from_rpy_radians(*(math.radians(v) for v in values[3:]))
            w, i, j, k = turned.wxyz.tolist()
            self._post(ToolHandleMoved((values[0], values[1], values[2]), (w, i, j, k)))
