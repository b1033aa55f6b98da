"""Controls and plots beside the scene."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import viser
from viser import uplot

from omniman_ros.viewer import text
from omniman_ros.viewer.hold import MOTIONS, Event, Held, Pressed, Released
from omniman_ros.viewer.state import SPAN, Array, Picture, Window

HEARTBEAT = 20.0
"""How often a page says that it holds a button [Hz]."""
PATH_NODE = "path_interpolator"
PATH_ACTIONS = ("pause", "resume", "cancel")
COLOURS = ("#1971c2", "#e8590c", "#2f9e44", "#9c36b5", "#c2255c", "#0c8599", "#5c940d", "#495057")
_ICONS = {
    "forward": viser.Icon.ARROW_UP, "back": viser.Icon.ARROW_DOWN,
    "left": viser.Icon.ARROW_LEFT, "right": viser.Icon.ARROW_RIGHT,
    "turn_left": viser.Icon.ROTATE_2, "turn_right": viser.Icon.ROTATE_CLOCKWISE_2,
}  # fmt: skip

Post = Callable[[Event], None]
"""Takes an event from a thread of the server's; must not block."""


class Controls:
    """Stop and reset on top, then driving and the path, then the state.

    Args:
        server: The page's.
        limits: Largest speed [m/s] and yaw rate [rad/s] of the sliders.
        post: Where events go.
    """

    def __init__(self, server: viser.ViserServer, limits: tuple[float, float], post: Post) -> None:
        gui = self._gui = server.gui
        self._post = post
        self._button("Stop", "stop", "red", viser.Icon.HAND_STOP)
        self._button("Reset", "reset", "green", viser.Icon.REFRESH)
        with gui.add_folder("Drive: hold a button"):
            buttons = [self._hold_button(motion) for motion in MOTIONS]
            gui.add_html(_side_by_side([button._impl.uuid for button in buttons]))
            self._linear = _speed_slider(gui, "m/s", limits[0])
            self._angular = _speed_slider(gui, "rad/s", limits[1])
        with gui.add_folder("Path"):
            self._path = [
                self._button(action.capitalize(), action, "gray", icon)
                for action, icon in zip(
                    PATH_ACTIONS,
                    (viser.Icon.PLAYER_PAUSE, viser.Icon.PLAYER_PLAY, viser.Icon.X),
                    strict=True,
                )
            ]
            gui.add_html(_side_by_side([button._impl.uuid for button in self._path]))
        with gui.add_folder("View"):
            self._follow = gui.add_checkbox("follow the robot", True)
            self._button("Clear trails", "clear", "gray", viser.Icon.ERASER)
        # Last: its lines come and go, and nothing that is pressed may move under a finger.
        with gui.add_folder("State"):
            self._status = gui.add_html("")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(330)

    # Callbacks are coroutines: viser runs those in the order in which a page has sent them, and
    # plain functions in a pool of threads.

    def _button(
        self, label: str, action: str, colour: Literal["red", "green", "gray"],
        icon: viser.IconName,
    ) -> viser.GuiButtonHandle:  # fmt: skip
        button = self._gui.add_button(label, color=colour, icon=icon)

        @button.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._post(Pressed(action))

        return button

    def _hold_button(self, motion: str) -> viser.GuiButtonHandle:
        label = motion.replace("_", " ").capitalize()
        button = self._gui.add_button(label, color="blue", icon=_ICONS[motion])

        @button.on_hold(callback_hz=HEARTBEAT)
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client_id is not None:
                self._post(Held(event.client_id, motion))

        # A click is a press and a release on the same button; every other end of holding is
        # noticed by the silence.
        @button.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client_id is not None:
                self._post(Released(event.client_id, motion))

        return button

    @property
    def follow(self) -> bool:
        """Whether the robot stays in the middle."""
        return bool(self._follow.value)

    @property
    def speeds(self) -> tuple[float, float]:
        """What the sliders say [m/s, rad/s]; a page may send anything."""
        return float(self._linear.value), float(self._angular.value)

    def draw(self, picture: Picture, now: float) -> None:
        """Show the state."""
        self._status.content = text.status(picture, now)
        for button, action in zip(self._path, PATH_ACTIONS, strict=True):
            button.disabled = f"{PATH_NODE}/{action}" not in picture.services


class Plots:
    """Live plots in a panel of their own.

    Args:
        server: The page's.
        wheels: Names of the wheels.
        constraints: Number of coupling errors.
    """

    def __init__(
        self, server: viser.ViserServer, wheels: tuple[str, ...], constraints: int
    ) -> None:
        gui = server.gui
        panel = gui.add_panel()
        colours = tuple(COLOURS[i % len(COLOURS)] for i in range(len(wheels)))
        with panel.add_tab("Plots", viser.Icon.CHART_LINE):
            self._speeds = _Plot(
                gui, "wheel speeds [rad/s], commanded dashed", 1.0,
                [(name, colour, False) for name, colour in zip(wheels, colours, strict=True)]
                + [(name, colour, True) for name, colour in zip(wheels, colours, strict=True)],
            )  # fmt: skip
            gui.add_html(text.legend(wheels, colours))
            errors = [f"constraint_{i + 1}" for i in range(constraints)]
            # Three wheels have no constraint between them.
            self._coupling = errors and _Plot(
                gui, "coupling error [rad]", 0.01,
                [(name, COLOURS[i % len(COLOURS)], False) for i, name in enumerate(errors)],
            )  # fmt: skip
        panel.dock_left()
        panel.set_width(330)

    def draw(self, picture: Picture, now: float) -> None:
        """Send the windows; the cost of a page is mostly this."""
        self._speeds.fill(picture.wheel_speeds, now)
        if self._coupling:
            self._coupling.fill(picture.coupling, now)


class _Plot:
    """Signals over the last seconds.

    Args:
        gui: Where to.
        title: What is plotted.
        least: The plot shows at least +- this, so that noise around zero is seen as such.
        signals: Name, colour and whether it is dashed.
    """

    def __init__(
        self, gui: viser.GuiApi, title: str, least: float, signals: list[tuple[str, str, bool]]
    ) -> None:
        series = [uplot.Series(label="s")]
        for name, colour, dashed in signals:
            line = uplot.Series(label=name, stroke=colour, width=1.5, points={"show": False})
            if dashed:
                line["dash"], line["width"] = (4.0, 4.0), 1.0
            series.append(line)
        series += [uplot.Series(label="", stroke="transparent", points={"show": False})] * 2
        self._least = least
        blank = np.full(2, np.nan)
        self._handle = gui.add_uplot(
            self._framed((np.array([-SPAN, 0.0]), *[blank] * len(signals))), tuple(series),
            title=title, height=230, legend=uplot.Legend(show=False),
            scales={"x": uplot.Scale(time=False, range=(-SPAN, 0.0)), "y": uplot.Scale()},
            axes=(uplot.Axis(), uplot.Axis(size=58.0)), padding=(8, 16, 0, 0),
        )  # fmt: skip

    def _framed(self, columns: tuple[Array, ...]) -> tuple[Array, ...]:
        bound = np.full(len(columns[0]), self._least)
        return (*columns, bound, -bound)

    def fill(self, window: Window, now: float) -> None:
        """Show what a window holds."""
        columns = window.columns(now)
        if len(columns[0]):
            self._handle.data = self._framed(columns)


def _speed_slider(gui: viser.GuiApi, label: str, limit: float) -> viser.GuiSliderHandle[float]:
    step = limit / 20.0
    return gui.add_slider(label, min=step, max=limit, step=step, initial_value=10.0 * step)


def _side_by_side(buttons: list[str], columns: int = 3) -> str:
    """Style that puts buttons next to each other, which viser stacks otherwise."""
    chosen = ",".join(f'div:has(>[id="{uuid}"])' for uuid in buttons)
    inner = ",".join(f'[id="{uuid}"]' for uuid in buttons)
    return (
        f"<style>{chosen}{{display:inline-block!important;vertical-align:top;"
        f"width:calc({100.0 / columns:.3f}% - 0.4em);margin-inline:0.2em!important}}"
        f"{inner}{{padding:0 0.2em;font-size:0.8em;touch-action:none;user-select:none}}</style>"
    )
