"""The controls beside the scene.

Stop has a panel of its own, and the motion buttons have another: each panel of viser sends only
the latest message every 50 ms, so that in a common panel a held button could displace Stop.
"""

from collections.abc import Iterable, Sequence

import viser

from omniman_ros.planning.cases import CASES
from omniman_ros.viewer import status_text
from omniman_ros.viewer.events import ButtonHeld, ButtonPressed, ButtonReleased, CaseSelected
from omniman_ros.viewer.hold_to_drive import MOTIONS
from omniman_ros.viewer.page import viser_compat as compat
from omniman_ros.viewer.page.floor_clicks import FloorClicks
from omniman_ros.viewer.page.inputs import ButtonColour, Post, add_button
from omniman_ros.viewer.page.keyboard import (
    CHORDS,
    KEY_DOWN_ATTRIBUTE,
    KEYS,
    chord_name,
    keyboard_script,
)
from omniman_ros.viewer.page.obstacle_panel import ObstaclePanel
from omniman_ros.viewer.page.parameter_panel import ParameterPanel
from omniman_ros.viewer.page.tool_panel import ToolPanel
from omniman_ros.viewer.perceived import LAYERS
from omniman_ros.viewer.style import (
    DRIVE_PANEL_HEIGHT,
    PANEL_WIDTH,
    STATE_PANEL_HEIGHT,
    STOP_PANEL_HEIGHT,
)
from omniman_ros.viewer.view_state import PAUSABLE_NODES, ViewState

HEARTBEAT = 20.0  #: Rate at which a page repeats that a button is held [Hz]

_MOTION_ICONS = {
    "forward": viser.Icon.ARROW_UP,
    "back": viser.Icon.ARROW_DOWN,
    "left": viser.Icon.ARROW_LEFT,
    "right": viser.Icon.ARROW_RIGHT,
    "turn_left": viser.Icon.ROTATE_2,
    "turn_right": viser.Icon.ROTATE_CLOCKWISE_2,
}
_TASK_ICONS = {
    "go": viser.Icon.FLAG,
    "pause": viser.Icon.PLAYER_PAUSE,
    "resume": viser.Icon.PLAYER_PLAY,
    "cancel": viser.Icon.X,
    "restart": viser.Icon.PLAYER_SKIP_BACK,
}


class Controls:
    """Stop and Reset at the top, the motion buttons below them, then tabs with the rest.

    Args:
        limits: Largest speed [m/s] and yaw rate [rad/s] of the sliders.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        limits: tuple[float, float],
        clicks: FloorClicks,
        post: Post,
    ) -> None:
        gui = self._gui = server.gui
        self._post = post
        stop = self._action_button("stop", "red", viser.Icon.HAND_STOP)
        reset = self._action_button("reset", "green", viser.Icon.REFRESH)
        drive = gui.add_panel()
        with drive.add_tab("Hold to drive", viser.Icon.DEVICE_GAMEPAD):
            motions = {motion: self._motion_button(motion) for motion in MOTIONS}
            self._linear = _speed_slider(gui, "m/s", limits[0])
            self._angular = _speed_slider(gui, "rad/s", limits[1])
            chords = {chord: self._chord_button(chord) for chord in CHORDS}
            script = keyboard_script(
                {chord: compat.element_id(button) for chord, button in chords.items()},
                {motion: compat.element_id(button) for motion, button in motions.items()},
                compat.element_id(stop),
            )
            gui.add_html(compat.script_html(script))
        tabs = gui.add_panel()
        with tabs.add_tab("Task"):
            self._add_task()
        with tabs.add_tab("Obstacles"):
            self._obstacles = ObstaclePanel(gui, clicks, post)
        with tabs.add_tab("Tool"):
            self._tool = ToolPanel(gui, post)
        self._parameters = ParameterPanel(gui, tabs.add_tab("Planner"), post)
        with tabs.add_tab("View"):
            self._follow = gui.add_checkbox("follow robot", True)
            self._layers = {name: gui.add_checkbox(name, on) for name, on in LAYERS.items()}
            self._action_button("clear", "gray", viser.Icon.ERASER, "Clear trails")
            self._action_button("tour", "gray", viser.Icon.MAP_2, "Tour: end, or begin anew")
        gui.add_html(_style([stop, reset], motions, list(chords.values())))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        drive.dock_below(gui.main_panel)
        tabs.dock_below(drive)

    def _add_task(self) -> None:
        gui = self._gui
        self._task = {
            action: self._action_button(action, "blue" if action == "go" else "gray", icon)
            for action, icon in _TASK_ICONS.items()
        }
        gui.add_html(
            status_text.hint(
                "Drag start (red) and goal (blue), then go. Or load a case of MPC 2021:"
            )
        )
        self._cases = {name: self._case_button(name) for name in CASES}
        buttons = [*self._task.values(), *self._cases.values()]
        gui.add_html(compat.style_html(compat.row_css(buttons)))

    def _action_button(
        self, action: str, colour: ButtonColour, icon: viser.IconName, label: str = ""
    ) -> viser.GuiButtonHandle:
        return add_button(
            self._gui,
            label or action.capitalize(),
            lambda: self._post(ButtonPressed(action)),
            colour,
            icon,
        )

    def _case_button(self, name: str) -> viser.GuiButtonHandle:
        return add_button(self._gui, name.capitalize(), lambda: self._post(CaseSelected(name)))

    def _motion_button(self, motion: str) -> viser.GuiButtonHandle:
        label = motion.replace("_", " ").capitalize()
        button = self._gui.add_button(label, color="blue", icon=_MOTION_ICONS[motion])
        self._connect(button, (motion,))
        return button

    def _chord_button(self, chord: tuple[str, ...]) -> viser.GuiButtonHandle:
        """Add a hidden button that the keyboard presses while all keys of the chord are down."""
        button = self._gui.add_button(chord_name(chord))
        self._connect(button, chord, [motion for motion in MOTIONS if motion not in chord])
        return button

    def _connect(
        self, button: viser.GuiButtonHandle, held: Iterable[str], released: Iterable[str] = ()
    ) -> None:
        """Post the events of a button that holds some motions and releases others."""

        @button.on_hold(callback_hz=HEARTBEAT)
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client_id is not None:
                for motion in released:
                    self._post(ButtonReleased(event.client_id, motion))
                for motion in held:
                    self._post(ButtonHeld(event.client_id, motion))

        # A click is a press and a release on the same button; every other end of a hold is
        # detected by the silence that follows.
        @button.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client_id is not None:
                for motion in held:
                    self._post(ButtonReleased(event.client_id, motion))

    @property
    def follow(self) -> bool:
        """Whether the scene keeps the robot in its middle."""
        return bool(self._follow.value)

    @property
    def layers(self) -> frozenset[str]:
        """Names of the layers that are switched on."""
        return frozenset(name for name, box in self._layers.items() if box.value)

    @property
    def speeds(self) -> tuple[float, float]:
        """Values of the sliders [m/s, rad/s]; a page may send any number."""
        return float(self._linear.value), float(self._angular.value)

    def draw(self, state: ViewState, now: float) -> None:
        """Update the controls, at a time on the clock of `state` [s]."""
        for action in ("pause", "resume", "cancel"):
            self._task[action].disabled = state.services.isdisjoint(
                f"{node}/{action}" for node in PAUSABLE_NODES
            )
        self._task["go"].disabled = state.goal is None
        for name, button in self._cases.items():
            button.color = "blue" if name == state.case else "gray"
        self._obstacles.draw(state, now)
        self._tool.draw(state, now)
        self._parameters.draw(state, now)


class StatusPanel:
    """The robot's state in words."""

    def __init__(self, server: viser.ViserServer, above: viser.PanelHandle) -> None:
        gui = server.gui
        panel = gui.add_panel()
        with panel.add_tab("State", viser.Icon.INFO_CIRCLE):
            self._text = gui.add_html("")
            gui.add_html(compat.marked_panel_html("omniman-state", STATE_PANEL_HEIGHT))
        panel.dock_below(above)

    def draw(self, state: ViewState, now: float) -> None:
        """Update the text, at a time on the clock of `state` [s]."""
        self._text.content = status_text.status(state, now)


def _speed_slider(gui: viser.GuiApi, label: str, limit: float) -> viser.GuiSliderHandle[float]:
    step = limit / 20.0
    return gui.add_slider(label, min=step, max=limit, step=step, initial_value=10.0 * step)


def _style(
    stop_and_reset: Sequence[viser.GuiButtonHandle],
    motions: dict[str, viser.GuiButtonHandle],
    hidden: Sequence[viser.GuiButtonHandle],
) -> str:
    """Return the style of the permanent controls: their heights and places, and key badges."""
    stop = stop_and_reset[0]
    buttons = list(motions.values())
    rules = [
        compat.row_css(stop_and_reset, 2),
        compat.row_css(buttons),
        compat.hidden_css(hidden),
        f"{compat.selector(stop_and_reset)}{{height:2.6em!important;font-size:1.05em}}",
        f"{compat.selector(buttons)}{{touch-action:none;user-select:none;font-size:0.74em}}",
        f"{compat.selector(buttons, f'[{KEY_DOWN_ATTRIBUTE}]')}{{filter:brightness(0.75)}}",
        compat.panel_height_css(stop, STOP_PANEL_HEIGHT),
        compat.panel_height_css(buttons[0], DRIVE_PANEL_HEIGHT),
        compat.FIXED_DOCK_CSS,
        compat.last_panel_css(buttons[0]),
        *(compat.badge_css(button, KEYS[motion]) for motion, button in motions.items()),
        compat.badge_css(stop, "Space"),
    ]
    return compat.style_html(*rules)
