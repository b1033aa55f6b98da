"""Live plots of the signals, in a panel of their own."""

from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from omniman_ros.core.arrays import Array
from omniman_ros.viewer import status_text
from omniman_ros.viewer.page.viser_compat import PLOT_CSS, style_html
from omniman_ros.viewer.signal_window import PLOT_SPAN, SignalWindow
from omniman_ros.viewer.style import LIMIT, PLOT_HEIGHT, SERIES
from omniman_ros.viewer.view_state import ViewState

DEFAULT_DEADLINE = 40.0  #: Deadline of the planner until it has reported its own [ms]
ARM_PERIOD = 8.0  #: Period between two setpoints of the arm [ms], CCTA 2017

Signal = tuple[str, str, bool]  #: Name and colour of a curve, and whether it is dashed


class Plots:
    """All plots of the page.

    Args:
        max_voltage: Largest voltage of the wheels' amplifiers [V].
    """

    def __init__(
        self,
        server: viser.ViserServer,
        wheels: tuple[str, ...],
        constraints: int,
        max_voltage: float,
    ) -> None:
        gui = server.gui
        self.panel = gui.add_panel()
        colours = [SERIES[i % len(SERIES)] for i in range(len(wheels))]
        solid: list[Signal] = [(name, c, False) for name, c in zip(wheels, colours, strict=True)]
        dashed: list[Signal] = [(name, c, True) for name, c in zip(wheels, colours, strict=True)]
        errors: list[Signal] = [
            (f"constraint_{i + 1}", SERIES[i % len(SERIES)], False) for i in range(constraints)
        ]
        self._plots: dict[str, _Plot] = {}
        with self.panel.add_tab("Wheels", viser.Icon.CHART_LINE):
            gui.add_html(style_html(PLOT_CSS))
            waiting = gui.add_html(status_text.hint("Waiting for wheel_states."))
            self._legend = gui.add_html(
                status_text.legend(wheels, tuple(colours))
                + status_text.hint(f"the last {PLOT_SPAN:g} s")
            )
            self._plots["speeds"] = _Plot(
                gui, "wheel speed [rad/s], commanded dashed", 1.0, solid + dashed
            )
            self._plots["voltages"] = _Plot(
                gui, "voltage [V], limits red", 1.0, solid, (max_voltage, -max_voltage)
            )
            # Three wheels have no constraint, hence no coupling error.
            if constraints:
                self._plots["coupling"] = _Plot(
                    gui, "coupling error, not reset at rest [mrad]", 10.0, errors, unit=1e-3
                )
            self._plots["energy"] = _Plot(gui, "energy [J]", 1.0, [("energy", SERIES[0], False)])
        self._waiting = [(waiting, tuple(self._plots))]
        with self.panel.add_tab("Planner & arm", viser.Icon.CHART_LINE):
            gui.add_html(style_html(PLOT_CSS))
            waiting = gui.add_html(status_text.hint("Waiting for mpc_planner and the arm."))
            self._plots["solving"] = _Plot(
                gui,
                "solving [ms], limit red; slack [mm] dashed",
                1.0,
                [("solve time", SERIES[0], False), ("slack", SERIES[3], True)],
                (DEFAULT_DEADLINE,),
            )
            self._plots["sending"] = _Plot(
                gui,
                "sending to the arm every [ms], longest dashed",
                1.0,
                [("mean", SERIES[0], False), ("longest", SERIES[1], True)],
                (ARM_PERIOD,),
            )
        self._waiting.append((waiting, ("solving", "sending")))
        self.panel.dock_left()

    def draw(self, state: ViewState, now: float) -> None:
        """Update the curves; most of the page's computing time is spent here."""
        deadline = state.planner_parameters.get("safety.deadline")
        if deadline is not None:
            self._plots["solving"].limits = (1e3 * deadline.value,)
        for name, plot in self._plots.items():
            plot.draw(state.windows[name], now)
        for hint, names in self._waiting:
            hint.visible = not any(
                self._plots[name].visible for name in names if name in self._plots
            )
        self._legend.visible = self._plots["speeds"].visible


class _Plot:
    """Signals over the last seconds; hidden until there are any.

    Args:
        min_amplitude: Half the smallest range of the y axis, so that noise is not magnified.
        unit: Unit of the plot, expressed in the unit of the window.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        min_amplitude: float,
        signals: Sequence[Signal],
        limits: tuple[float, ...] = (),
        unit: float = 1.0,
    ) -> None:
        series = [uplot.Series(label="s")]
        for name, colour, dashed in signals:
            line = uplot.Series(label=name, stroke=colour, width=1.5, points={"show": False})
            if dashed:
                line["dash"], line["width"] = (4.0, 4.0), 1.0
            series.append(line)
        for _ in limits:
            series.append(uplot.Series(label="", stroke=LIMIT, width=1.0, points={"show": False}))
        series += [uplot.Series(label="", stroke="transparent", points={"show": False})] * 2
        self.limits = limits  #: Values of the lines that mark limits; their number must not change
        self._min_amplitude = min_amplitude
        self._unit = unit
        self._signals = len(signals)
        self._empty = True
        font, ticks = "10px sans-serif", uplot.Axis_Ticks(size=4.0)
        self._handle = gui.add_uplot(
            self._with_lines((np.array([-PLOT_SPAN, 0.0]), *[np.full(2, np.nan)] * len(signals))),
            tuple(series),
            title=title,
            height=PLOT_HEIGHT,
            visible=False,
            legend=uplot.Legend(show=False),
            scales={"x": uplot.Scale(time=False, range=(-PLOT_SPAN, 0.0)), "y": uplot.Scale()},
            axes=(
                uplot.Axis(show=False),
                uplot.Axis(size=36.0, gap=2.0, font=font, space=18.0, ticks=ticks),
            ),
            padding=(4, 10, 4, 0),
        )

    @property
    def visible(self) -> bool:
        return bool(self._handle.visible)

    def _with_lines(self, columns: tuple[Array, ...]) -> tuple[Array, ...]:
        count = len(columns[0])
        across = (*self.limits, self._min_amplitude, -self._min_amplitude)
        return (*columns, *(np.full(count, value) for value in across))

    def draw(self, window: SignalWindow, now: float) -> None:
        columns = window.columns(now)
        known = any(np.isfinite(column).any() for column in columns[1:])
        if known and not self.visible:
            self._handle.visible = True
        # An empty window is sent only once, to clear the plot: a silent signal costs nothing.
        if self.visible and (known or not self._empty):
            self._empty = not known
            times, *curves = columns
            if self._unit != 1.0:
                curves = [curve / self._unit for curve in curves]
            self._handle.data = self._with_lines((times, *curves))
