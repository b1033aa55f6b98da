"""Figures of this package to which the papers have no counterpart, for the page of `all`."""

from omniman_ros.lab.reproduce.findings import Finding, Results
from omniman_ros.lab.reproduce.published import Claim


def _scenes(results: Results) -> Finding:
    whole = results["scenes"]["groups"]["all"]
    return Finding(
        {name: whole[name] for name in ("drives", "reached", "own_collisions", "answer_p99_ms")},
        f"{whole['reached']} of {whole['drives']} goals reached, {whole['own_collisions']} "
        f"avoidable contacts, {whole['other_collisions']} others; an answer takes "
        f"{whole['answer_median_ms']:.1f} ms, p99 {whole['answer_p99_ms']:.0f} ms",
    )


def _path(results: Results) -> Finding:
    track = results["demo"]["tracking"]
    return Finding(track, f"{track['rms_mm']:.2f} mm RMS, {track['max_mm']:.2f} mm at most")


def _drift(results: Results) -> Finding:
    off = results["demo"]["odometry"]
    return Finding(
        off,
        f"{off['position_mm']:.1f} mm after {off['travel_m']:.1f} m and {off['turn_rad']:.1f} rad",
    )


def _tool(results: Results) -> Finding:
    tool = results["demo"]["tool"]
    return Finding(
        tool,
        f"{tool['rms_mm']:.2f} mm RMS, {tool['max_mm']:.2f} mm at most, on "
        f"{tool['length_m']:.1f} m",
    )


def _goal(results: Results) -> Finding:
    goal = results["demo"]["goal"]
    return Finding(
        goal,
        f"{goal['time_s']:.1f} s, off by {goal['position_mm']:.0f} mm, least gap "
        f"{1e3 * goal['clearance_m']:.0f} mm",
    )


def _dead_wheel(results: Results) -> Finding:
    dead = results["demo"]["dead_wheel"]
    return Finding(
        dead, f"noticed after {dead['noticed_s']:.2f} s; then {dead['rms_mm']:.1f} mm RMS"
    )


def _control(results: Results) -> Finding:
    bench = results["bench_control"]
    ticks = bench["core_tick_us"]
    return Finding(
        {"core_tick_us": ticks, "latency_ratio": bench["latency_ratio"]},
        ", ".join(f"{name} {micros:.0f} µs" for name, micros in ticks.items())
        + f"; latency {bench['latency_ratio']:.2f} of a bare relay's",
    )


def _solver(results: Results) -> Finding:
    bench = results["bench_mpc"]
    cycle = bench["alone"]["N=20 M=4"]["cycle"]
    ratio = bench["ratios"]["ipopt_over_cycle"]["median"]
    return Finding(
        {**cycle, "ipopt_ratio": ratio},
        f"median {cycle['median_ms']:.1f} ms, p99 {cycle['p99_ms']:.1f} ms; IPOPT takes "
        f"{ratio:.1f} times as long on the same problems",
    )


def _bus(results: Results) -> Finding:
    cases = results["bench_can"]["cases"]
    slowest = max(case["bridge"]["median_ms"] for case in cases)
    ratio = max(case["ratio"] for case in cases)
    return Finding(
        {"median_ms": slowest, "ratio": ratio},
        f"median {slowest:.2f} ms, up to {ratio:.2f} of bare python-can's",
    )


def _stream(results: Results) -> Finding:
    ratio = results["bench_arm"]["ratio"]
    return Finding({"ratio": ratio}, f"p99 is {ratio:.2f} of a bare loop's")


FIGURES: tuple[Claim, ...] = (
    Claim("Random scenes", "", "", ("scenes",), _scenes),
    Claim("Demo: platform off its path", "", "", ("demo",), _path),
    Claim("Demo: odometry off the truth", "", "", ("demo",), _drift),
    Claim("Demo: tool off its path", "", "", ("demo",), _tool),
    Claim("Demo: goal among moving obstacles", "", "", ("demo",), _goal),
    Claim("Demo: a dead wheel", "", "", ("demo",), _dead_wheel),
    Claim("Control tick, CPU", "", "", ("bench_control",), _control),
    Claim("Planner's cycle, n = 20, four obstacles", "", "", ("bench_mpc",), _solver),
    Claim("Round trip over CAN", "", "", ("bench_can",), _bus),
    Claim("Setpoints of the arm in the running robot", "", "", ("bench_arm",), _stream),
)
"""The figures in the order in which they are shown; those without results are left out."""
