"""Buttons and number inputs of the page, and the style that viser has no word for.

Callbacks are coroutines: viser runs those in the order in which a page has sent them, and plain
functions in a pool of threads.
"""

from collections.abc import Callable, Iterable
from typing import Literal

import viser

from omniman_ros.viewer.events import Event
from omniman_ros.viewer.settling import Settling

Post = Callable[[Event], None]
"""Takes an event from a thread of the server's; must not block."""
Colour = Literal["red", "green", "gray", "blue", "orange"]


def add_button(
    gui: viser.GuiApi, label: str, post: Callable[[], None], colour: Colour = "gray",
    icon: viser.IconName | None = None,
) -> viser.GuiButtonHandle:  # fmt: skip
    """A button that does something when it is clicked."""
    button = gui.add_button(label, color=colour, icon=icon)

    @button.on_click
    async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client_id is not None:
            post()

    return button


def identity(handle: viser.GuiInputHandle[float] | viser.GuiButtonHandle) -> str:
    """Id of the element in the page."""
    return str(handle._impl.uuid)


def row(buttons: Iterable[viser.GuiButtonHandle], columns: int = 3) -> str:
    """Style that puts buttons next to each other, which viser stacks otherwise."""
    ids = [identity(button) for button in buttons]
    around = ",".join(f'div:has(>[id="{uuid}"])' for uuid in ids)
    inner = ",".join(f'[id="{uuid}"]' for uuid in ids)
    return (
        f"{around}{{display:inline-block!important;vertical-align:top;"
        f"width:calc({100.0 / columns:.3f}% - 0.5em);margin-inline:0.25em!important}}"
        f"{inner}{{padding:0 0.2em;font-size:0.8em}}"
    )


class NumberInput:
    """A number that the page sets and the node has.

    Args:
        gui: Where to.
        label: Name and unit.
        low, high: What is taken; outside, the page refuses it, or it is dropped.
        step: Of the arrows beside it.
        hint: What it means.
    """

    def __init__(
        self, gui: viser.GuiApi, label: str, low: float, high: float, step: float,
        hint: str | None = None,
    ) -> None:  # fmt: skip
        self._settling = Settling(low, high)
        start = min(max(0.0, low), high)
        self.handle = gui.add_number(
            label, float(start), min=float(low), max=float(high), step=step, hint=hint
        )

        @self.handle.on_update
        async def _(event: viser.GuiEvent[viser.GuiNumberHandle[float]]) -> None:
            # What this program sets itself comes back without a client.
            if event.client_id is not None:
                self._settling.ask(event.target.value)

    def draw(self, value: float, now: float) -> float | None:
        """Show what the node has; returns what the page asks for instead, once."""
        asked = self._settling.step(now)
        # A value that a page has made NaN differs from all, itself too.
        if asked is None and self._settling.is_open(now) and self.handle.value != value:
            self.handle.value = value  # type: ignore[misc]
        return asked

    def reopen(self) -> None:
        """Forget what was asked for: the number now stands for something else."""
        self._settling.reopen()
