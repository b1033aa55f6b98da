"""The state of the robot as HTML. All text is escaped: a node may choose any name for itself."""

import math
from collections.abc import Iterator, Mapping
from html import escape

from omniman_ros.viewer.style import BAD, GOOD, MUTED, PROMINENT, WARNING
from omniman_ros.viewer.view_state import ViewState

_LEVEL_COLOURS = (GOOD, WARNING, BAD)  #: Colours of the levels of a condition: ok, warning, error

_SOURCE_COLOURS = {"stop": BAD, "none": MUTED}
_PLANNER_COLOURS = {"driving": GOOD, "arrived": GOOD, "blocked": BAD, "paused": WARNING}
MAX_LENGTH = 160  #: Largest number of characters displayed of one message


def status(state: ViewState, now: float) -> str:
    """Return HTML with the tour, the pace of time, the active source, stops, pose and problems."""
    rows = (
        _tour_rows,
        _time_rows,
        _motion_rows,
        _pose_rows,
        _progress_rows,
        _safety_rows,
        _diagnostic_rows,
        _frame_rows,
        _note_rows,
    )
    return (
        '<div style="padding:0 0.75em 0.4em;font-size:0.8em;line-height:1.5;'
        'overflow-wrap:anywhere">'
        + "".join(row for make in rows for row in make(state, now))
        + "</div>"
    )


def _tour_rows(state: ViewState, now: float) -> Iterator[str]:
    if state.tour:
        yield f'<div style="font-weight:600;color:{PROMINENT}">{_short(state.tour)}</div>'


def _time_rows(state: ViewState, now: float) -> Iterator[str]:
    if state.awaited:
        names = ", ".join(name.rpartition("/")[2] for name in state.awaited)
        yield _row("simulated time", f"is waiting for {names}", WARNING)
    elif state.pace is not None:
        yield _row("simulated time", f"{state.pace:.2f} times real time", "")


def _motion_rows(state: ViewState, now: float) -> Iterator[str]:
    source = state.active_source
    if source:
        yield _row("driven by", source, _SOURCE_COLOURS.get(source, GOOD))
    else:
        yield _row("driven by", "waiting for platform_controller", WARNING)
    for name, condition in sorted(state.stops.items()):
        yield _row(name.rpartition("/")[2], condition.text, _LEVEL_COLOURS[condition.level])


def _pose_rows(state: ViewState, now: float) -> Iterator[str]:
    if state.odom is None:
        yield _row("odom", "not received yet", WARNING)
        return
    x, y, theta = state.odom
    colour = "" if state.is_fresh("odom", now) else WARNING
    heading = math.degrees(math.remainder(theta, math.tau))
    yield _row("odom", f"{x:+.2f} {y:+.2f} m {heading:+.0f}°", colour)
    if state.truth and state.is_fresh("truth", now):
        error = math.dist(state.odom[:2], state.truth[:2])
        yield _row("odometry error", f"{1e3 * error:.1f} mm", "")


def _progress_rows(state: ViewState, now: float) -> Iterator[str]:
    if state.is_fresh("progress", now):
        yield _row("path", f"{100.0 * state.progress:.0f} %", "")
    if state.is_fresh("planner", now):
        yield _row("planner", *_planner(state.planner))


def _safety_rows(state: ViewState, now: float) -> Iterator[str]:
    perceived = state.perceived
    if perceived.body is not None and perceived.body.nearest is not None:
        nearest = perceived.body.nearest
        yield _row("nearest", f"{nearest.distance:.2f} m from {nearest.part}", "")
    fractions = perceived.speed_fractions
    if fractions is not None and min(fractions) < 1.0:
        platform, arm = (100.0 * fraction for fraction in fractions)
        yield _row("speed limit", f"platform {platform:.0f} %, arm {arm:.0f} %", WARNING)
    if perceived.tip_over_margin is not None:
        colour = BAD if perceived.tip_over_margin < 0.0 else ""
        yield _row("tip-over margin", f"{perceived.tip_over_margin:.2f} m", colour)
    for contact in perceived.contacts.values():
        yield _row("contact", f"{contact.text}, {contact.force:.0f} N", BAD)


def _diagnostic_rows(state: ViewState, now: float) -> Iterator[str]:
    for name, condition in sorted(state.diagnostics.items()):
        if name in state.stops and condition.text in state.stops[name].text:
            continue  # the row of the stop state has the same text
        yield _row(name.rpartition("/")[2], condition.text, _LEVEL_COLOURS[condition.level])


def _frame_rows(state: ViewState, now: float) -> Iterator[str]:
    for topic, reason in sorted(state.unplaced.items()):
        yield _row(topic, f"not shown: {reason}", WARNING)


def _note_rows(state: ViewState, now: float) -> Iterator[str]:
    if state.note:
        yield f'<div style="color:{MUTED}">{_short(state.note)}</div>'


def _planner(status_values: Mapping[str, str]) -> tuple[str, str]:
    """Return what the planner does in words, and the colour to display it in."""
    planner_state = status_values.get("state", "")
    words = planner_state
    distance = status_values.get("distance_m")
    if planner_state in ("driving", "blocked") and distance:
        words += f", {distance} m to go"
    if why := status_values.get("why"):
        words += f": {why}"
    return words, _PLANNER_COLOURS.get(planner_state, MUTED)


def _row(name: str, text: str, colour: str) -> str:
    style = f"font-weight:600;color:{colour}" if colour else "font-variant-numeric:tabular-nums"
    return (
        f'<div><span style="color:{MUTED}">{_short(name)}</span> '
        f'<span style="{style}">{_short(text)}</span></div>'
    )


def _short(text: str) -> str:
    return escape(text if len(text) <= MAX_LENGTH else text[: MAX_LENGTH - 3] + "...")


def hint(text: str) -> str:
    """Return HTML of a line that tells the user what to do."""
    return (
        f'<div style="padding:0 0.9em 0.5em;font-size:0.75em;color:{MUTED}">{_short(text)}</div>'
    )


def legend(names: tuple[str, ...], colours: tuple[str, ...]) -> str:
    """Return HTML that explains the colours of a plot."""
    items = " ".join(
        f'<span style="color:{colour};white-space:nowrap">&#9632; {escape(name)}</span>'
        for name, colour in zip(names, colours, strict=True)
    )
    return f'<div style="padding:0 0.9em 0.5em;font-size:0.75em">{items}</div>'
