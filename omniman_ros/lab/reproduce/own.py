"""Measured results of this package without a counterpart in the papers.

`omniman reproduce all` shows them in a table of their own.
"""

from omniman_ros.lab.reproduce.findings import Finding, Results, find_row
from omniman_ros.lab.reproduce.published import Claim
from omniman_ros.lab.studies.coupling import LAG_CONTROLLER


def _random_scenes(results: Results) -> Finding:
    """Return goals reached, contacts and answer times of the planner in random scenes."""
    all_drives = results["scenes"]["groups"]["all"]
    return Finding(
        {
            name: all_drives[name]
            for name in ("drives", "reached", "own_collisions", "answer_p99_ms")
        },
        f"{all_drives['reached']} of {all_drives['drives']} goals reached, "
        f"{all_drives['own_collisions']} avoidable and {all_drives['other_collisions']} "
        f"unavoidable contacts; time to answer: median {all_drives['answer_median_ms']:.1f} ms, "
        f"p99 {all_drives['answer_p99_ms']:.0f} ms",
    )


def _coupling_margins(results: Results) -> Finding:
    """Return the delays from which coupling control oscillates, with the wheels off the floor."""
    stability = results["coupling"]["stability"]
    margins = {
        f"{row['k']:.3g}": row["computed_s"]
        for row in stability["margins"]
        if row["computed_s"] is not None
    }
    return Finding(
        {"computed_s": margins, "compared": stability["compared"], "agree": stability["agree"]},
        "wheels off the floor: settles up to "
        + ", ".join(f"{1e3 * delay:.0f} ms at k = {gain}" for gain, delay in margins.items())
        + f"; computed as measured in {stability['agree']} of {stability['compared']} steps",
    )


def _modes(results: Results) -> Finding:
    """Return what coupling control does to error and energy in each mode of the drives."""
    study = results["coupling"]
    gain = study["chosen_gain"]
    values, texts = {}, []
    for mode in ("P", "PI", "torque"):
        off, on = (find_row(study, mode, k) for k in (0.0, gain))
        ratio = on["epsilon_ratio"]["mean"]
        energies = [row["energy"]["mean"] for row in (off, on)]
        values[mode] = {"ratio": ratio, "energies_j": energies}
        texts.append(f"{mode}: {ratio:.2f} of it, {energies[0]:.0f} → {energies[1]:.0f} J")
    return Finding(values, f"k = {gain:g}, without the rollers' lag: " + ", ".join(texts))


def _modes_with_lag(results: Results) -> Finding:
    """Return what coupling control that knows the lag of the rollers does in each mode."""
    every = results["coupling"]["aims"]
    aims = [aim for aim in every if aim["controller"] == LAG_CONTROLLER]
    return Finding(
        {"aims": aims},
        ", ".join(
            f"{aim['group']} at k = {aim['k']:g}: {aim['error_ratio']:.2f} of the error, "
            f"{aim['energy_ratio']:.2f} of the energy"
            for aim in aims
        ),
    )


def _platform_tracking(results: Results) -> Finding:
    """Return the tracking error of the platform on its path in the demo."""
    error = results["demo"]["tracking"]
    return Finding(error, f"{error['rms_mm']:.2f} mm RMS, {error['max_mm']:.2f} mm at most")


def _odometry_drift(results: Results) -> Finding:
    """Return the position error of odometry at the end of the demo."""
    drift = results["demo"]["odometry"]
    return Finding(
        drift,
        f"{drift['position_mm']:.1f} mm after {drift['travel_m']:.1f} m and "
        f"{drift['turn_rad']:.1f} rad",
    )


def _tool_tracking(results: Results) -> Finding:
    """Return the tracking error of the tool on its path in the demo."""
    tool = results["demo"]["tool"]
    return Finding(
        tool,
        f"{tool['rms_mm']:.2f} mm RMS, {tool['max_mm']:.2f} mm at most, on a "
        f"path of {tool['length_m']:.1f} m",
    )


def _goal_drive(results: Results) -> Finding:
    """Return duration, final error and smallest gap of the demo's drive to a goal."""
    goal = results["demo"]["goal"]
    return Finding(
        goal,
        f"{goal['time_s']:.1f} s, final error {goal['position_mm']:.0f} mm, least gap "
        f"{1e3 * goal['clearance_m']:.0f} mm",
    )


def _dead_wheel(results: Results) -> Finding:
    """Return the detection time of a dead wheel in the demo, and the tracking error after it."""
    dead = results["demo"]["dead_wheel"]
    return Finding(
        dead,
        f"detected after {dead['noticed_s']:.2f} s; error then {dead['rms_mm']:.1f} mm RMS",
    )


def _control_tick(results: Results) -> Finding:
    """Return the CPU time of a tick of the platform controller, and the latency of its node."""
    bench = results["bench_control"]
    ticks = bench["core_tick_us"]
    return Finding(
        {"core_tick_us": ticks, "latency_ratio": bench["latency_ratio"]},
        ", ".join(f"{name} {micros:.0f} µs" for name, micros in ticks.items())
        + f"; latency {bench['latency_ratio']:.2f} times that of a bare relay",
    )


def _planner_cycle(results: Results) -> Finding:
    """Return the CPU time of a planner cycle, and that of IPOPT in relation to it."""
    bench = results["bench_mpc"]
    cycle = bench["alone"]["N=20 M=4"]["cycle"]
    ratio = bench["ratios"]["ipopt_over_cycle"]["median"]
    return Finding(
        {**cycle, "ipopt_ratio": ratio},
        f"median {cycle['median_ms']:.1f} ms, p99 {cycle['p99_ms']:.1f} ms; IPOPT takes "
        f"{ratio:.1f} times as long on the same problems",
    )


def _can_round_trip(results: Results) -> Finding:
    """Return the round-trip time over CAN, and its ratio to that of bare python-can."""
    cases = results["bench_can"]["cases"]
    slowest = max(case["bridge"]["median_ms"] for case in cases)
    ratio = max(case["ratio"] for case in cases)
    return Finding(
        {"median_ms": slowest, "ratio": ratio},
        f"median {slowest:.2f} ms, up to {ratio:.2f} times that of bare python-can",
    )


def _arm_setpoints(results: Results) -> Finding:
    """Return the ratio of the p99 setpoint interval to that of a bare loop."""
    ratio = results["bench_arm"]["ratio"]
    return Finding({"ratio": ratio}, f"p99 is {ratio:.2f} times that of a bare loop")


OWN_RESULTS: tuple[Claim, ...] = (
    Claim("Coupling control with late commands", "", "", ("coupling",), _coupling_margins),
    Claim("Coupling control by mode of the drives", "", "", ("coupling",), _modes),
    Claim("Coupling control with the rollers' lag", "", "", ("coupling",), _modes_with_lag),
    Claim("Random scenes", "", "", ("scenes",), _random_scenes),
    Claim("Demo: tracking error of the platform", "", "", ("demo",), _platform_tracking),
    Claim("Demo: drift of odometry", "", "", ("demo",), _odometry_drift),
    Claim("Demo: tracking error of the tool", "", "", ("demo",), _tool_tracking),
    Claim("Demo: goal among moving obstacles", "", "", ("demo",), _goal_drive),
    Claim("Demo: dead wheel", "", "", ("demo",), _dead_wheel),
    Claim("Control tick, CPU time", "", "", ("bench_control",), _control_tick),
    Claim("Planner cycle, n = 20, four obstacles", "", "", ("bench_mpc",), _planner_cycle),
    Claim("Round-trip time over CAN", "", "", ("bench_can",), _can_round_trip),
    Claim(
        "Setpoint interval of the arm, whole robot running", "", "", ("bench_arm",), _arm_setpoints
    ),
)
"""Results in the order in which they are shown; those that were not measured are left out."""
