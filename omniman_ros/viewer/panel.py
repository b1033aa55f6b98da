"""Controls beside the scene.

Stop stands alone in a panel of its own, and the buttons to drive in another: each panel of
viser's sends one message in 50 ms, the latest, and a button that is held would outdo Stop.
"""

from collections.abc import Iterable, Mapping

import viser

from omniman_ros.planning.cases import CASES
from omniman_ros.viewer import keys, text
from omniman_ros.viewer.buttons import Colour, Post, add_button, identity, row
from omniman_ros.viewer.events import CaseChosen, Held, Pressed, Released
from omniman_ros.viewer.hold import MOTIONS
from omniman_ros.viewer.obstacle_panel import ObstaclePanel
from omniman_ros.viewer.state import Picture
from omniman_ros.viewer.tuning_panel import TuningPanel

HEARTBEAT = 20.0
"""How often a page says that it holds a button [Hz]."""
WIDTH = 310.0
"""Of the panels at either side [px]."""
STOP_HEIGHT, DRIVE_HEIGHT, STATE_HEIGHT = 100, 180, 270
"""Of the panels that are always there [px]."""
PAUSABLE = ("path_interpolator", "mpc_planner")
"""Nodes that can be paused."""
_ICONS = {
    "forward": viser.Icon.ARROW_UP, "back": viser.Icon.ARROW_DOWN,
    "left": viser.Icon.ARROW_LEFT, "right": viser.Icon.ARROW_RIGHT,
    "turn_left": viser.Icon.ROTATE_2, "turn_right": viser.Icon.ROTATE_CLOCKWISE_2,
}  # fmt: skip
_TASK_ICONS = {
    "go": viser.Icon.FLAG, "pause": viser.Icon.PLAYER_PAUSE, "resume": viser.Icon.PLAYER_PLAY,
    "cancel": viser.Icon.X, "restart": viser.Icon.PLAYER_SKIP_BACK,
}  # fmt: skip


class Controls:
    """Stop and reset on top, then driving, then tabs of all the rest.

    Args:
        server: The page's.
        limits: Largest speed [m/s] and yaw rate [rad/s] of the sliders.
        post: Where events go.
    """

    def __init__(self, server: viser.ViserServer, limits: tuple[float, float], post: Post) -> None:
        gui = self._gui = server.gui
        self._post = post
        stop = self._press("stop", "red", viser.Icon.HAND_STOP)
        reset = self._press("reset", "green", viser.Icon.REFRESH)
        drive = gui.add_panel()
        with drive.add_tab("Hold to drive", viser.Icon.DEVICE_GAMEPAD):
            shown = {motion: self._hold_button(motion) for motion in MOTIONS}
            self._linear = _speed_slider(gui, "m/s", limits[0])
            self._angular = _speed_slider(gui, "rad/s", limits[1])
            chords = {chord: self._chord_button(chord) for chord in keys.CHORDS}
            gui.add_html(
                keys.html(
                    {chord: identity(button) for chord, button in chords.items()},
                    {motion: identity(button) for motion, button in shown.items()},
                    identity(stop),
                )
            )
        tabs = gui.add_panel()
        with tabs.add_tab("Task"):
            self._make_task()
        with tabs.add_tab("Obstacles"):
            self._obstacles = ObstaclePanel(gui, post)
        self._tuning = TuningPanel(gui, tabs.add_tab("Planner"), post)
        with tabs.add_tab("View"):
            self._follow = gui.add_checkbox("follow robot", True)
            self._press("clear", "gray", viser.Icon.ERASER, "Clear trails")
        gui.add_html(_style(stop, reset, shown, chords.values()))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH)
        drive.dock_below(gui.main_panel)
        tabs.dock_below(drive)

    def _make_task(self) -> None:
        gui = self._gui
        self._task = {
            action: self._press(action, "blue" if action == "go" else "gray", icon)
            for action, icon in _TASK_ICONS.items()
        }
        gui.add_html(
            text.hint("Drag start (red) and goal (blue), then go. Or load a case of MPC 2021:")
        )
        self._cases = {name: self._case(name) for name in CASES}
        buttons = [*self._task.values(), *self._cases.values()]
        gui.add_html(f"<style>{row(buttons)}</style>")

    def _press(
        self, action: str, colour: Colour, icon: viser.IconName, label: str = ""
    ) -> viser.GuiButtonHandle:
        return add_button(
            self._gui, label or action.capitalize(), lambda: self._post(Pressed(action)), colour,
            icon,
        )  # fmt: skip

    def _case(self, name: str) -> viser.GuiButtonHandle:
        return add_button(self._gui, name.capitalize(), lambda: self._post(CaseChosen(name)))

    def _hold_button(self, motion: str) -> viser.GuiButtonHandle:
        label = motion.replace("_", " ").capitalize()
        button = self._gui.add_button(label, color="blue", icon=_ICONS[motion])
        self._on_hold(button, (motion,))
        return button

    def _chord_button(self, chord: tuple[str, ...]) -> viser.GuiButtonHandle:
        """A button that is not seen: the keyboard's, one for all keys that are down."""
        button = self._gui.add_button(keys.name(chord))
        self._on_hold(button, chord, [motion for motion in MOTIONS if motion not in chord])
        return button

    def _on_hold(
        self, button: viser.GuiButtonHandle, held: Iterable[str], released: Iterable[str] = ()
    ) -> None:
        @button.on_hold(callback_hz=HEARTBEAT)
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client_id is not None:
                for motion in released:
                    self._post(Released(event.client_id, motion))
                for motion in held:
                    self._post(Held(event.client_id, motion))

        # A click is a press and a release on the same button; every other end of holding is
        # noticed by the silence.
        @button.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client_id is not None:
                for motion in held:
                    self._post(Released(event.client_id, motion))

    @property
    def follow(self) -> bool:
        """Whether the robot stays in the middle."""
        return bool(self._follow.value)

    @property
    def speeds(self) -> tuple[float, float]:
        """What the sliders say [m/s, rad/s]; a page may send anything."""
        return float(self._linear.value), float(self._angular.value)

    def draw(self, picture: Picture, now: float) -> None:
        """Show the state, at a time [s]."""
        for action in ("pause", "resume", "cancel"):
            self._task[action].disabled = picture.services.isdisjoint(
                f"{node}/{action}" for node in PAUSABLE
            )
        self._task["go"].disabled = picture.goal is None
        for name, button in self._cases.items():
            button.color = "blue" if name == picture.case else "gray"
        self._obstacles.draw(picture, now)
        self._tuning.draw(picture, now)


class Status:
    """The robot's state in words.

    Args:
        server: The page's.
        below: The panel that it stands under.
    """

    def __init__(self, server: viser.ViserServer, below: viser.PanelHandle) -> None:
        gui = server.gui
        panel = gui.add_panel()
        with panel.add_tab("State", viser.Icon.INFO_CIRCLE):
            self._words = gui.add_html("")
            # viser would share the height evenly between the two.
            gui.add_html(
                '<style class="omniman-state">[data-dock-scroll]>div:has(.omniman-state){flex:0 0 '
                f"{STATE_HEIGHT}px!important}}"
                "[data-dock-scroll]>div:first-child:has(~div .omniman-state)"
                "{flex:1 1 0!important}</style>"
            )
        panel.dock_below(below)

    def draw(self, picture: Picture, now: float) -> None:
        """Show the state, at a time [s]."""
        self._words.content = text.status(picture, now)


def _speed_slider(gui: viser.GuiApi, label: str, limit: float) -> viser.GuiSliderHandle[float]:
    step = limit / 20.0
    return gui.add_slider(label, min=step, max=limit, step=step, initial_value=10.0 * step)


def _style(
    stop: viser.GuiButtonHandle, reset: viser.GuiButtonHandle,
    shown: Mapping[str, viser.GuiButtonHandle], hidden: Iterable[viser.GuiButtonHandle],
) -> str:  # fmt: skip
    """Style of what is always there: heights of its panels, Stop larger, keys on the buttons."""
    motions = [f'[id="{identity(button)}"]' for button in shown.values()]
    rules = [
        row((stop, reset), 2),
        row(shown.values()),
        ",".join(f'div:has(>[id="{identity(button)}"])' for button in hidden)
        + "{display:none!important}",
        f'[id="{identity(stop)}"],[id="{identity(reset)}"]'
        "{height:2.6em!important;font-size:1.05em}",
        f"{','.join(motions)}{{touch-action:none;user-select:none;font-size:0.74em}}",
        f"{','.join(f'{one}[{keys.HELD}]' for one in motions)}{{filter:brightness(0.75)}}",
    ]
    for button, height in ((stop, STOP_HEIGHT), (next(iter(shown.values())), DRIVE_HEIGHT)):
        rules.append(
            f'[data-dock-scroll]>div:has([id="{identity(button)}"])'
            f"{{flex:0 0 {height}px!important}}"
        )
    # viser gives each panel a share of what was its neighbour's; the last one takes the rest.
    # The bar that folds the panels at this side: Stop would be folded away with them.
    rules.append('[data-dock-region-handle="right"]{display:none!important}')
    above = f'[data-dock-scroll]>div:has([id="{identity(next(iter(shown.values())))}"])'
    rules.append(f"{above}~div:last-child{{flex:1 1 0!important}}")
    badges = {identity(button): keys.KEYS[motion] for motion, button in shown.items()}
    for uuid, key in {**badges, identity(stop): "Space"}.items():
        # The second text is what a screen reader says: the button's name is its label alone.
        rules.append(
            f'[id="{uuid}"]::after{{content:"{key}";content:"{key}"/"";position:absolute;'
            "right:3px;top:2px;font-size:0.75em;line-height:1;opacity:0.8}"
        )
    return f"<style>{''.join(rules)}</style>"
