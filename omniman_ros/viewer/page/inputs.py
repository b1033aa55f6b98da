"""Buttons and number inputs of the page.

All callbacks are coroutines: viser runs these in the order in which a page has sent its messages,
but plain functions in a pool of threads.
"""

from collections.abc import Callable, Sequence
from typing import Literal

import viser

from omniman_ros.viewer.debounced_value import DebouncedValue
from omniman_ros.viewer.events import Event

Post = Callable[[Event], None]  #: Accepts an event from any thread of the server; must not block
ButtonColour = Literal["red", "green", "gray", "blue", "orange"]  #: Colour of a button


def add_button(
    gui: viser.GuiApi,
    label: str,
    on_click: Callable[[], None],
    colour: ButtonColour = "gray",
    icon: viser.IconName | None = None,
) -> viser.GuiButtonHandle:
    """Add a button that calls `on_click` when a browser clicks it."""
    button = gui.add_button(label, color=colour, icon=icon)

    @button.on_click
    async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client_id is not None:
            on_click()

    return button


class NumberInput:
    """A number that page and node can set within a range; others are refused or discarded."""

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        low: float,
        high: float,
        step: float,
        hint: str | None = None,
    ) -> None:
        self._entry = DebouncedValue(low, high)
        start = min(max(0.0, low), high)
        self.handle = gui.add_number(
            label, float(start), min=float(low), max=float(high), step=step, hint=hint
        )

        @self.handle.on_update
        async def _(event: viser.GuiEvent[viser.GuiNumberHandle[float]]) -> None:
            # A value that this program has set comes back without a client.
            if event.client_id is not None:
                self._entry.request(event.target.value)

    def draw(self, value: float, now: float) -> float | None:
        """Display the node's value at any steady time [s]; return a newly requested value once."""
        requested = self._entry.step(now)
        # If a page has set NaN, the value differs from every number, itself included.
        if requested is None and self._entry.is_idle(now) and self.handle.value != value:
            # viser's handle declares the value of a number as read-only for its type variable.
            self.handle.value = value  # type: ignore[misc]
        return requested

    def reset(self) -> None:
        """Discard an entry, because the number now stands for something else."""
        self._entry.reset()


def draw_pair(
    inputs: Sequence[NumberInput], pair: tuple[float, float], now: float
) -> tuple[float, float]:
    """Display two numbers, rounded to 1/1000; return them, with newly requested values instead."""
    first, second = (
        value if (requested := number.draw(round(value, 3), now)) is None else requested
        for number, value in zip(inputs, pair, strict=True)
    )
    return first, second
