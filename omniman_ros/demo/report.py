"""The table of figures and limits at the end of the demo."""

import sys
from typing import Any

from omniman_ros.console.terminal import RED, paint, table
from omniman_ros.demo.measures import LIMITS

ROWS = """\
tracking error in odom, RMS | {tracking[rms_mm]:.2f} mm | {limit[tracking.rms_mm]:g} mm
tracking error in odom, max | {tracking[max_mm]:.2f} mm | {limit[tracking.max_mm]:g} mm
heading error, RMS | {tracking[heading_rms_deg]:.2f} deg |
pose at the end of the path | {tracking[final_mm]:.2f} mm | {limit[tracking.final_mm]:g} mm
twist error, worst ({worst[name]}) | {worst[mm_s]:.1f} mm/s | {worst[limit]:g} mm/s
coupling error, RMS / max | {coupling[rms_rad]:.4f} / {coupling[max_rad]:.4f} rad |
odometry error after {odometry[travel_m]:.1f} m | {odometry[position_mm]:.1f} mm \
| {limit[odometry.position_mm]:g} mm
heading error after {odometry[turn_rad]:.1f} rad | {odometry[heading_deg]:.2f} deg \
| {limit[odometry.heading_deg]:g} deg
arm after {arm[moves]} moves: error of the worst joint | {arm[final_mrad]:.2f} mrad \
| {limit[arm.final_mrad]:g} mrad
  tracking error, RMS; lag | {arm[rms_mrad]:.2f} mrad, {arm[lag_ms]:.0f} ms \
| {limit[arm.rms_mrad]:g} mrad, {limit[arm.lag_ms]:g} ms
  setpoints by TCP: interval p50 / p99 \
| {arm[setpoints][p50_ms]:.2f} / {arm[setpoints][p99_ms]:.2f} ms |
tool on a path of {tool[length_m]:.1f} m: error, RMS / max \
| {tool[rms_mm]:.2f} / {tool[max_mm]:.2f} mm \
| {limit[tool.rms_mm]:g} / {limit[tool.max_mm]:g} mm
  by the ground truth (includes odometry's drift) \
| {tool[true_rms_mm]:.2f} / {tool[true_max_mm]:.2f} mm |
  smallest clearance of the body, by the ground truth \
| {body[mm]:.0f} mm | above {limit[tool.clearance_m]:g}
goal among obstacles, after {goal[time_s]:.1f} s: error \
| {goal[position_mm]:.0f} mm, {goal[heading_deg]:.1f} deg \
| {limit[goal.position_mm]:g} mm, {limit[goal.heading_deg]:g} deg
  smallest clearance of an obstacle | {clearance[mm]:.0f} mm | above {limit[goal.clearance_m]:g}
wheel '{dead_wheel[wheel]}' without torque: detected after \
| {dead_wheel[noticed_s]:.2f} s | {limit[dead_wheel.noticed_s]:g} s
  tracking error without the wheel, RMS | {dead_wheel[rms_mm]:.2f} mm \
| {limit[dead_wheel.rms_mm]:g} mm
emergency stop at {emergency_stop[speed_m_s]:.2f} m/s: time, distance \
| {emergency_stop[rest_s]:.2f} s, {emergency_stop[way_mm]:.0f} mm \
| {limit[emergency_stop.rest_s]:g} s
  arm at {emergency_stop[arm_rate_rad_s]:.2f} rad/s: time to rest \
| {emergency_stop[arm_rest_s]:.2f} s | {limit[emergency_stop.arm_rest_s]:g} s
  distance moved within 1 s after the reset | {emergency_stop[moved_mm]:.2f} mm \
| {limit[emergency_stop.moved_mm]:g} mm
things touched | {contacts[count]}{touched} | {limit[contacts.count]:g}
energy drawn by the motors | {energy[total_j]:.0f} J |
odom: rate, interval p50 / p99 | {timing[odom][rate_hz]:.1f} Hz, \
{timing[odom][p50_ms]:.2f} / {timing[odom][p99_ms]:.2f} ms \
| {limit[timing.odom.rate_hz]:g} Hz
wheel_commands: rate, p50 / p99 | {timing[wheel_commands][rate_hz]:.1f} Hz, \
{timing[wheel_commands][p50_ms]:.2f} / {timing[wheel_commands][p99_ms]:.2f} ms \
| {limit[timing.wheel_commands.rate_hz]:g} Hz
"""  #: Name, value and limit of each row; a row is left out if the result lacks one of its figures


def report_lines(result: dict[str, Any]) -> list[str]:
    """Return the lines of the table of figures by section; see `omniman_ros.demo.demo.judge`."""
    values = result | _derived_values(result)
    rows: list[tuple[str, ...]] = [("", "value", "limit")]
    for template in ROWS.splitlines():
        name, *cells = template.split("|")
        try:
            row = [text.format(**values) for text in (name.rstrip(), *cells)]
        except KeyError:
            continue
        rows.append((row[0], *(cell.strip() for cell in row[1:])))
    return ["", *table(rows)]


def fault_lines(faults: list[str]) -> str:
    """Return the sentences about figures beyond their limits as text, with a heading in red."""
    head = paint("The robot did not do what it should:", RED, sys.stdout)
    return "\n".join([head, *(f"  {fault}" for fault in faults)])


def _derived_values(result: dict[str, Any]) -> dict[str, Any]:
    """Return the limits by their figures, and values in other units than the result's."""
    limit = {limit.figure: limit.value for limit in LIMITS}
    worst = max(result["twists"], key=lambda twist: twist["linear_m_s"])
    touched = result.get("contacts", {}).get("with")
    values: dict[str, Any] = {
        "limit": limit,
        "worst": {
            "name": worst["name"],
            "mm_s": 1e3 * worst["linear_m_s"],
            "limit": 1e3 * limit["twists.linear_m_s"],
        },
        "touched": f": {'; '.join(touched)}" if touched else "",
    }
    if "clearance_m" in result.get("goal", {}):
        values["clearance"] = {"mm": 1e3 * result["goal"]["clearance_m"]}
    if "clearance_m" in result.get("tool", {}):
        values["body"] = {"mm": 1e3 * result["tool"]["clearance_m"]}
    return values
