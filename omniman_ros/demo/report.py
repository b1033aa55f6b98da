"""The table of figures and limits at the end of the demo."""

import sys
from typing import Any

from omniman_ros.console.terminal import RED, paint, table
from omniman_ros.demo.demo import LIMITS

Row = tuple[str, ...]
"""Name of a figure, its value and its limit, as text."""
LIMIT_VALUES = {limit.figure: limit.value for limit in LIMITS}
"""Limit of each figure, by the keys of the figure."""


def report_lines(result: dict[str, Any]) -> list[str]:
    """Return the lines of the table.

    Args:
        result: Figures by section; see `omniman_ros.demo.demo.judge`.
    """
    rows: list[Row] = [
        ("", "value", "limit"),
        *_path_rows(result),
        *_odometry_rows(result),
        *_arm_rows(result),
        *_tool_rows(result),
        *_goal_rows(result),
        *_dead_wheel_rows(result),
        *_stop_rows(result),
        *_contact_rows(result),
        ("energy drawn by the motors", f"{result['energy']['total_j']:.0f} J", ""),
        _rate_row("odom: rate, interval p50 / p99", result, "odom"),
        _rate_row("wheel_commands: rate, p50 / p99", result, "wheel_commands"),
    ]
    return ["", *table(rows)]


def fault_lines(faults: list[str]) -> str:
    """Return the sentences about figures beyond their limits as text, with a heading in red."""
    head = paint("The robot did not do what it should:", RED, sys.stdout)
    return "\n".join([head, *(f"  {fault}" for fault in faults)])


def _limit(figure: str, factor: float = 1.0) -> str:
    """Return the limit of a figure, multiplied by a conversion factor of its unit, as text."""
    return f"{factor * LIMIT_VALUES[figure]:g}"


def _path_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the path and of the twists."""
    tracking, coupling = result["tracking"], result["coupling"]
    worst = max(result["twists"], key=lambda twist: twist["linear_m_s"])
    return [
        (
            "tracking error in odom, RMS",
            f"{tracking['rms_mm']:.2f} mm",
            f"{_limit('tracking.rms_mm')} mm",
        ),
        (
            "tracking error in odom, max",
            f"{tracking['max_mm']:.2f} mm",
            f"{_limit('tracking.max_mm')} mm",
        ),
        ("heading error, RMS", f"{tracking['heading_rms_deg']:.2f} deg", ""),
        (
            "pose at the end of the path",
            f"{tracking['final_mm']:.2f} mm",
            f"{_limit('tracking.final_mm')} mm",
        ),
        (
            f"twist error, worst ({worst['name']})",
            f"{1e3 * worst['linear_m_s']:.1f} mm/s",
            f"{_limit('twists.linear_m_s', 1e3)} mm/s",
        ),
        (
            "coupling error, RMS / max",
            f"{coupling['rms_rad']:.4f} / {coupling['max_rad']:.4f} rad",
            "",
        ),
    ]


def _odometry_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of odometry's drift."""
    drift = result["odometry"]
    return [
        (
            f"odometry error after {drift['travel_m']:.1f} m",
            f"{drift['position_mm']:.1f} mm",
            f"{_limit('odometry.position_mm')} mm",
        ),
        (
            f"heading error after {drift['turn_rad']:.1f} rad",
            f"{drift['heading_deg']:.2f} deg",
            f"{_limit('odometry.heading_deg')} deg",
        ),
    ]


def _contact_rows(result: dict[str, Any]) -> list[Row]:
    """Return the row of the contacts; none without a physics world."""
    if "contacts" not in result:
        return []
    contacts = result["contacts"]
    names = f": {'; '.join(contacts['with'])}" if contacts["with"] else ""
    return [("things touched", f"{contacts['count']}{names}", _limit("contacts.count"))]


def _rate_row(name: str, result: dict[str, Any], topic: str) -> Row:
    """Return the row of the rate and the intervals of a topic."""
    timing = result["timing"][topic]
    return (
        name,
        f"{timing['rate_hz']:.1f} Hz, {timing['p50_ms']:.2f} / {timing['p99_ms']:.2f} ms",
        f"{_limit(f'timing.{topic}.rate_hz')} Hz",
    )


def _arm_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the arm; none if there is no arm."""
    if "arm" not in result:
        return []
    arm = result["arm"]
    setpoints = arm["setpoints"]
    return [
        (
            f"arm after {arm['moves']} moves: error of the worst joint",
            f"{arm['final_mrad']:.2f} mrad",
            f"{_limit('arm.final_mrad')} mrad",
        ),
        (
            "  tracking error, RMS; lag",
            f"{arm['rms_mrad']:.2f} mrad, {arm['lag_ms']:.0f} ms",
            f"{_limit('arm.rms_mrad')} mrad, {_limit('arm.lag_ms')} ms",
        ),
        (
            "  setpoints by TCP: interval p50 / p99",
            f"{setpoints['p50_ms']:.2f} / {setpoints['p99_ms']:.2f} ms",
            "",
        ),
    ]


def _tool_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the tool's path; none if there is no arm."""
    if "tool" not in result:
        return []
    tool = result["tool"]
    return [
        (
            f"tool on a path of {tool['length_m']:.1f} m: error, RMS / max",
            f"{tool['rms_mm']:.2f} / {tool['max_mm']:.2f} mm",
            f"{_limit('tool.rms_mm')} / {_limit('tool.max_mm')} mm",
        ),
        (
            "  by the ground truth (includes odometry's drift)",
            f"{tool['true_rms_mm']:.2f} / {tool['true_max_mm']:.2f} mm",
            "",
        ),
    ]


def _goal_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the goal among obstacles; none if there was no goal."""
    if "goal" not in result:
        return []
    goal = result["goal"]
    return [
        (
            f"goal among obstacles, after {goal['time_s']:.1f} s: error",
            f"{goal['position_mm']:.0f} mm, {goal['heading_deg']:.1f} deg",
            f"{_limit('goal.position_mm')} mm, {_limit('goal.heading_deg')} deg",
        ),
        *_clearance_rows(goal),
    ]


def _clearance_rows(goal: dict[str, Any]) -> list[Row]:
    """Return the row of the clearance; none if there was nothing that moves."""
    if "clearance_m" not in goal:
        return []
    return [
        (
            "  smallest clearance of an obstacle",
            f"{1e3 * goal['clearance_m']:.0f} mm",
            f"above {_limit('goal.clearance_m')}",
        )
    ]


def _dead_wheel_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the path with a dead wheel; none if no wheel could be spared."""
    if "dead_wheel" not in result:
        return []
    dead = result["dead_wheel"]
    return [
        (
            f"wheel '{dead['wheel']}' without torque: detected after",
            f"{dead['noticed_s']:.2f} s",
            f"{_limit('dead_wheel.noticed_s')} s",
        ),
        (
            "  tracking error without the wheel, RMS",
            f"{dead['rms_mm']:.2f} mm",
            f"{_limit('dead_wheel.rms_mm')} mm",
        ),
    ]


def _stop_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the emergency stop; none if there was none."""
    if "emergency_stop" not in result:
        return []
    stop = result["emergency_stop"]
    rows: list[Row] = [
        (
            f"emergency stop at {stop['speed_m_s']:.2f} m/s: time, distance",
            f"{stop['rest_s']:.2f} s, {stop['way_mm']:.0f} mm",
            f"{_limit('emergency_stop.rest_s')} s",
        ),
    ]
    if "arm_rest_s" in stop:
        rows.append(
            (
                f"  arm at {stop['arm_rate_rad_s']:.2f} rad/s: time to rest",
                f"{stop['arm_rest_s']:.2f} s",
                f"{_limit('emergency_stop.arm_rest_s')} s",
            )
        )
    rows.append(
        (
            "  distance moved within 1 s after the reset",
            f"{stop['moved_mm']:.2f} mm",
            f"{_limit('emergency_stop.moved_mm')} mm",
        )
    )
    return rows
