"""Synthetic results of experiments with every field that the page of `all` reads."""

ABOUT = {"time": "2026-01-02T03:04:05+00:00", "python": "3", "machine": "m", "cores": 2}


def spread(value):
    return {"mean": value, "worst": value}


def wheels(group, gain, ratio, slip=20.0, odometry=0.005, controller="package"):
    return {
        "group": group,
        "controller": controller,
        "k": gain,
        "epsilon_max": spread(1.5 * ratio),
        "slip": spread(slip),
        "epsilon_ratio": spread(ratio),
        "odometry_max": spread(odometry),
        "epsilon_max_samples": [1.5 * ratio] * 2,
    }


def ride(about="defaults", **changes):
    return {
        "about": about,
        "reached": True,
        "collided": False,
        "time_s": 8.5,
        "energy_j": 150.0,
        "clearance_m": 0.06,
        "cycles": 170,
        "plans_used": 170,
        "cpu_median_ms": 4.0,
        "cpu_p99_ms": 9.0,
        "along_diagonal": True,
        "share": 0.86,
        "peak_turn_rad": 0.5,
        "backwards_share": 0.0,
    } | changes


def case(**changes):
    drives = [ride(**changes), ride("voltages put out"), ride("the paper's horizon")]
    return {
        "robot": "ig42",
        "quick": False,
        "full": False,
        "seed": 0,
        "passed": True,
        "drives": drives,
        "took_s": 10.0,
        "about": ABOUT,
    }


def paper_ride(position=20.0, heading=5.0, about="weights", **changes):
    return {
        "about": about,
        "w_pos": position,
        "w_ang": heading,
        "peak_speed_m_s": 2.0,
        "peak_speed_s": 1.5,
        "rest_s": 5.6,
        "rest_m": 0.1,
        "rest_rad": 0.05,
        "goal_m": 6.0,
        "way_shares": [0.3, 0.6, 0.96],
        "compared_s": 3.6,
        "compared_j": 214.0,
        "along_diagonal": True,
        "share": 0.92,
        "turn_to_diagonal_rad": 0.4,
    } | changes


def group(**changes):
    return {
        "drives": 8,
        "reached": 8,
        "solvable": 8,
        "own_collisions": 0,
        "other_collisions": 0,
        "answer_median_ms": 5.0,
        "answer_p99_ms": 20.0,
    } | changes


EVERYTHING = {
    "coupling": {
        "robot": "omniman",
        "quick": False,
        "full": False,
        "seed": 0,
        "samples": 10,
        "chosen_gain": 15.0,
        "printed_gain": 63.0,
        "stability": {
            "margins": [{"k": 63.0, "computed_s": 0.019, "settles_s": 0.01, "oscillates_s": 0.02}],
            "compared": 9,
            "agree": 8,
        },
        "aim": {"met": True},
        "took_s": 300.0,
        "about": ABOUT,
        "uncontrolled_rad": dict.fromkeys("abcde", 0.1),
        "table": [
            wheels("P", 0.0, 1.0),
            wheels("P", 2.0, 0.45, 8.0, 0.003),
            wheels("P", 15.0, 0.09, 2.0, 0.002),
            wheels("PI", 0.0, 1.0),
            wheels("PI", 2.0, 0.7, 3.0, 0.004),
            wheels("P", 2.0, 0.4, 7.0, 0.003, "paper"),
            wheels("P", 63.0, 0.01, 1.0, 0.002, "paper"),
            wheels("PI", 2.0, 0.6, 3.0, 0.004, "paper"),
            wheels("PI", 63.0, 0.02, 1.0, 0.004, "paper"),
        ],
    },
    "tool_path": {
        "robot": "omniman",
        "quick": False,
        "seed": 0,
        "passed": True,
        "took_s": 60.0,
        "about": ABOUT,
        "bounds": {"rms_mm": 2.0, "max_mm": 5.0},
        "drives": [
            {"correction": True, "rms_mm": 0.3, "max_mm": 2.0},
            {"correction": False, "rms_mm": 9.0, "max_mm": 10.0},
        ],
    },
    "odometry": {
        "robot": "omniman",
        "quick": False,
        "full": False,
        "seed": 0,
        "drives": [{"group": "PI"}],
        "took_s": 10.0,
        "about": ABOUT,
    },
    "handover": {
        "robot": "omniman",
        "quick": False,
        "full": False,
        "seed": 0,
        "passed": True,
        "took_s": 60.0,
        "about": ABOUT,
        "speed_m_s": 0.3,
        "kept_s": 5.0,
        "bounds": {"position_mm": 20.0, "heading_deg": 1.0},
        "drives": [
            {"is_aim": True, "max_mm": 1.2, "heading_max_deg": 0.1, "least_gap_m": 0.59},
            {"is_aim": False, "max_mm": 40.0, "heading_max_deg": 1.3, "least_gap_m": 0.5},
        ],
    },
    "free": case(clearance_m=None) | {"energy": [{"ratio": 0.9}, {"ratio": 1.1}]},
    "free_paper": {
        "robot": "ig42",
        "quick": False,
        "full": False,
        "seed": 0,
        "passed": True,
        "took_s": 30.0,
        "about": ABOUT,
        "compared_way_m": 5.0,
        "drives": [
            paper_ride(600.0, 150.0),
            paper_ride(),
            paper_ride(20.0, 500.0, "heading held", compared_s=3.7, compared_j=228.0),
        ],
    },
    "corridor": case(),
    "moving": case(),
    "workshop": case(),
    "scenes": {
        "robot": "ig42",
        "seed": 0,
        "passed": True,
        "took_s": 400.0,
        "about": ABOUT,
        "drives": [{}] * 8,
        "groups": {"all": group(), "model off by up to 20 %": group()},
    },
    "demo": {
        "ok": True,
        "about": ABOUT,
        "tracking": {"rms_mm": 0.35, "max_mm": 1.3},
        "arm": {"setpoints": {"p50_ms": 8.0, "p99_ms": 8.4}},
    },
    "bench_mpc": {
        "about": ABOUT,
        "alone": {"N=20 M=4": {"cycle": {"median_ms": 3.1, "p99_ms": 3.9}}},
        "ratios": {"ipopt_over_cycle": {"median": 10.8, "p99": 20.0}},
    },
    "bench_arm": {"about": ABOUT, "ratio": 0.9, "streamer": {"p50_ms": 8.0, "p99_ms": 8.4}},
    "identify_friction": {
        "about": ABOUT,
        "wheels": [{"viscous": {"value": 0.05}, "coulomb": {"value": 0.6}}],
    },
}
"""By the name of the experiment; whoever changes one puts it back."""
