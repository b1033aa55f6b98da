"""Number inputs for the planner's weights and distances."""

import math

import viser

from omniman_ros.viewer.events import ParameterChanged
from omniman_ros.viewer.page.inputs import NumberInput, Post
from omniman_ros.viewer.status_text import hint
from omniman_ros.viewer.view_state import ViewState


class ParameterPanel:
    """A number input for each parameter of the planner, added when it is first received."""

    def __init__(self, gui: viser.GuiApi, tab: viser.GuiTabHandle, post: Post) -> None:
        self._gui = gui
        self._tab = tab
        self._post = post
        self._numbers: dict[str, NumberInput] = {}
        with tab:
            self._hint = gui.add_html(hint("Waiting for mpc_planner."))

    def draw(self, state: ViewState, now: float) -> None:
        """Display the planner's values, at a time on the clock of `state` [s]."""
        self._hint.visible = not state.planner_parameters
        for name, tunable in state.planner_parameters.items():
            if name not in self._numbers:
                with self._tab:
                    self._numbers[name] = NumberInput(
                        self._gui,
                        label(name),
                        tunable.low,
                        tunable.high,
                        step(tunable.value),
                        tunable.text,
                    )
            requested = self._numbers[name].draw(tunable.value, now)
            if requested is not None and requested != tunable.value:
                self._post(ParameterChanged(name, requested))
        for name, number in self._numbers.items():
            number.handle.disabled = name not in state.planner_parameters


def label(name: str) -> str:
    """Return a readable name of a parameter: `weights.position` is `position weight`."""
    group, _, last = name.rpartition(".")
    words = last.replace("_", " ")
    return f"{words} weight" if group == "weights" else words


def step(value: float) -> float:
    """Return about a twentieth of a value, rounded down to 1, 2 or 5 times a power of ten."""
    if not value > 0.0:
        return 0.01
    twentieth = value / 20.0
    power = 10.0 ** math.floor(math.log10(twentieth))
    return float(power * max(n for n in (1, 2, 5) if n * power <= twentieth * (1.0 + 1e-9)))
