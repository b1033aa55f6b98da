"""What the planner can be set to: weights and distances."""

import math

import viser

from omniman_ros.viewer.buttons import NumberInput, Post
from omniman_ros.viewer.events import Tuned
from omniman_ros.viewer.state import Picture
from omniman_ros.viewer.text import hint


class TuningPanel:
    """A number for each parameter, made when it is first heard of.

    Args:
        gui: Where to.
        tab: In which tab.
        post: Where events go.
    """

    def __init__(self, gui: viser.GuiApi, tab: viser.GuiTabHandle, post: Post) -> None:
        self._gui = gui
        self._tab = tab
        self._post = post
        self._numbers: dict[str, NumberInput] = {}
        with tab:
            self._said = gui.add_html(hint("Waiting for mpc_planner."))

    def draw(self, picture: Picture, now: float) -> None:
        """Show what the planner has, at a time [s]."""
        self._said.visible = not picture.tunables
        for name, tunable in picture.tunables.items():
            if name not in self._numbers:
                with self._tab:
                    self._numbers[name] = NumberInput(
                        self._gui, label(name), tunable.low, tunable.high, step(tunable.value),
                        tunable.text,
                    )  # fmt: skip
            asked = self._numbers[name].draw(tunable.value, now)
            if asked is not None and asked != tunable.value:
                self._post(Tuned(name, asked))
        for name, number in self._numbers.items():
            number.handle.disabled = name not in picture.tunables


def label(name: str) -> str:
    """A parameter's name for people: `weights.position` is `position weight`."""
    group, _, last = name.rpartition(".")
    words = last.replace("_", " ")
    return f"{words} weight" if group == "weights" else words


def step(value: float) -> float:
    """A twentieth of a value or so, as a round number: 1, 2 or 5 times a power of ten."""
    if not value > 0.0:
        return 0.01
    share = value / 20.0
    power = 10.0 ** math.floor(math.log10(share))
    return float(power * max(n for n in (1, 2, 5) if n * power <= share * (1.0 + 1e-9)))
