"""Live plots in a panel of their own."""

from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from omniman_ros.viewer import text
from omniman_ros.viewer.state import Picture
from omniman_ros.viewer.window import SPAN, Array, Window

COLOURS = ("#1971c2", "#e8590c", "#2f9e44", "#9c36b5", "#c2255c", "#0c8599", "#5c940d", "#495057")
LIMIT = "#e03131"
HEIGHT = 104
"""Of a plot: three of them stand below each other on a small screen [px]."""
DEADLINE = 40.0
"""Of the planner, until it has told its own [ms]."""
ARM_PERIOD = 8.0
"""Between two setpoints of the arm [ms], CCTA 2017."""

_STYLE = (
    "<style>.uplot .u-title{font-size:0.75em!important;padding:2px 0 0!important}"
    ".uplot-container{margin-block:0.3em!important;padding:0!important}</style>"
)

Signal = tuple[str, str, bool]
"""Name, colour, and whether it is dashed."""


class Plots:
    """All plots.

    Args:
        server: The page's.
        wheels: Names of the wheels.
        constraints: Number of coupling errors.
        max_voltage: Of the wheels' amplifiers [V].

    Attributes:
        panel: Where they are.
    """

    def __init__(
        self, server: viser.ViserServer, wheels: tuple[str, ...], constraints: int,
        max_voltage: float,
    ) -> None:  # fmt: skip
        gui = server.gui
        self.panel = gui.add_panel()
        colours = [COLOURS[i % len(COLOURS)] for i in range(len(wheels))]
        solid: list[Signal] = [(name, c, False) for name, c in zip(wheels, colours, strict=True)]
        dashed: list[Signal] = [(name, c, True) for name, c in zip(wheels, colours, strict=True)]
        errors: list[Signal] = [
            (f"constraint_{i + 1}", COLOURS[i % len(COLOURS)], False) for i in range(constraints)
        ]
        self._plots: dict[str, _Plot] = {}
        with self.panel.add_tab("Wheels", viser.Icon.CHART_LINE):
            gui.add_html(_STYLE)
            waiting = gui.add_html(text.hint("Waiting for wheel_states."))
            self._legend = gui.add_html(
                text.legend(wheels, tuple(colours)) + text.hint(f"the last {SPAN:g} s")
            )
            self._plots["speeds"] = _Plot(
                gui, "wheel speed [rad/s], commanded dashed", 1.0, solid + dashed
            )
            self._plots["voltages"] = _Plot(
                gui, "voltage [V], limits red", 1.0, solid, (max_voltage, -max_voltage)
            )
            # Three wheels have no constraint between them.
            if constraints:
                self._plots["coupling"] = _Plot(
                    gui, "coupling error [mrad]", 10.0, errors, unit=1e-3
                )
            self._plots["energy"] = _Plot(gui, "energy [J]", 1.0, [("energy", COLOURS[0], False)])
        self._waiting = [(waiting, tuple(self._plots))]
        with self.panel.add_tab("Planner & arm", viser.Icon.CHART_LINE):
            gui.add_html(_STYLE)
            waiting = gui.add_html(text.hint("Waiting for mpc_planner and the arm."))
            self._plots["solving"] = _Plot(
                gui, "solving [ms], limit red; slack [mm] dashed", 1.0,
                [("solve time", COLOURS[0], False), ("slack", COLOURS[3], True)], (DEADLINE,),
            )  # fmt: skip
            self._plots["sending"] = _Plot(
                gui, "sending to the arm every [ms], longest dashed", 1.0,
                [("mean", COLOURS[0], False), ("longest", COLOURS[1], True)], (ARM_PERIOD,),
            )  # fmt: skip
        self._waiting.append((waiting, ("solving", "sending")))
        self.panel.dock_left()

    def draw(self, picture: Picture, now: float) -> None:
        """Send the windows; the cost of a page is mostly this."""
        deadline = picture.tunables.get("safety.deadline")
        if deadline is not None:
            self._plots["solving"].limits = (1e3 * deadline.value,)
        for name, plot in self._plots.items():
            plot.fill(picture.windows[name], now)
        for said, names in self._waiting:
            said.visible = not any(
                self._plots[name].visible for name in names if name in self._plots
            )
        self._legend.visible = self._plots["speeds"].visible


class _Plot:
    """Signals over the last seconds; not seen until there are any.

    Args:
        gui: Where to.
        title: What is plotted.
        least: The plot shows at least +- this, so that noise around zero is seen as such.
        signals: What it shows.
        limits: Lines across.
        unit: Of what is plotted, in that of the window.

    Attributes:
        limits: As above; as many as at first.
    """

    def __init__(
        self, gui: viser.GuiApi, title: str, least: float, signals: Sequence[Signal],
        limits: tuple[float, ...] = (), unit: float = 1.0,
    ) -> None:  # fmt: skip
        series = [uplot.Series(label="s")]
        for name, colour, dashed in signals:
            line = uplot.Series(label=name, stroke=colour, width=1.5, points={"show": False})
            if dashed:
                line["dash"], line["width"] = (4.0, 4.0), 1.0
            series.append(line)
        for _ in limits:
            series.append(uplot.Series(label="", stroke=LIMIT, width=1.0, points={"show": False}))
        series += [uplot.Series(label="", stroke="transparent", points={"show": False})] * 2
        self.limits = limits
        self._least = least
        self._unit = unit
        self._signals = len(signals)
        self._empty = True
        font, ticks = "10px sans-serif", uplot.Axis_Ticks(size=4.0)
        self._handle = gui.add_uplot(
            self._framed((np.array([-SPAN, 0.0]), *[np.full(2, np.nan)] * len(signals))),
            tuple(series), title=title, height=HEIGHT, visible=False,
            legend=uplot.Legend(show=False),
            scales={"x": uplot.Scale(time=False, range=(-SPAN, 0.0)), "y": uplot.Scale()},
            axes=(
                uplot.Axis(show=False),
                uplot.Axis(size=36.0, gap=2.0, font=font, space=18.0, ticks=ticks),
            ),
            padding=(4, 10, 4, 0),
        )  # fmt: skip

    @property
    def visible(self) -> bool:
        """Whether it is seen."""
        return bool(self._handle.visible)

    def _framed(self, columns: tuple[Array, ...]) -> tuple[Array, ...]:
        count = len(columns[0])
        across = (*self.limits, self._least, -self._least)
        return (*columns, *(np.full(count, value) for value in across))

    def fill(self, window: Window, now: float) -> None:
        """Show what a window holds."""
        columns = window.columns(now)
        known = any(np.isfinite(column).any() for column in columns[1:])
        if known and not self.visible:
            self._handle.visible = True
        # An empty window is sent once, to wipe the plot: what is silent costs nothing.
        if self.visible and (known or not self._empty):
            self._empty = not known
            times, *curves = columns
            if self._unit != 1.0:
                curves = [curve / self._unit for curve in curves]
            self._handle.data = self._framed((times, *curves))
