"""Agreement of measured results with the claims of the papers."""

import copy

import pytest

from omniman_ros.lab.reproduce.findings import Verdict
from omniman_ros.lab.reproduce.own import OWN_RESULTS
from omniman_ros.lab.reproduce.published import CLAIMS
from test.lab.reproduce.reproduced import EVERYTHING, group, paper_ride, ride, wheels

BY_NAME = {claim.quantity: claim for claim in CLAIMS}


@pytest.fixture
def results():
    return copy.deepcopy(EVERYTHING)


def verdict(results, quantity):
    """Return what the rule of a claim says, whether or not it may be called agreement."""
    return BY_NAME[quantity].measure(results).verdict.value


def put(results, *row):
    """Replace a row of the coupling study."""
    new = wheels(*row)
    table = results["coupling"]["table"]
    key = ("group", "k", "controller")
    table[:] = [old for old in table if any(old[name] != new[name] for name in key)] + [new]


def test_every_claim_cites_its_source_and_is_printable():
    assert len(BY_NAME) == len(CLAIMS)
    for claim in CLAIMS:
        assert claim.source.startswith(("CCTA 2017, ", "MPC 2021, "))
        assert claim.published
        assert claim.needs
        assert claim.quantity.isascii()


def test_with_all_results_every_claim_is_measured(results):
    found = {claim.quantity: claim.find(results) for claim in CLAIMS}
    assert [name for name, finding in found.items() if finding.verdict is Verdict.MISSING] == []
    for name, finding in found.items():
        # Claims with a rule are judged, unless they are unlike; claims without a rule are shown.
        assert (finding.verdict is Verdict.SHOWN) == (not BY_NAME[name].rule), name
        assert (finding.verdict is Verdict.UNLIKE) == bool(BY_NAME[name].unlike), name
        assert finding.text and finding.values


def test_other_conditions_are_never_called_agreement_or_difference(results):
    unlike = [claim for claim in CLAIMS if claim.unlike]
    assert {claim.needs for claim in unlike} >= {("free",), ("corridor",), ("moving",)}
    for claim in unlike:
        assert claim.find(results).verdict is Verdict.UNLIKE
        assert "the rule is " in claim.find(results).text
    backwards = BY_NAME["Narrow corridor: driving backwards"]
    assert backwards.find(results).text.endswith("the rule is not met")
    results["corridor"]["drives"][0] = ride(backwards_share=0.2)
    assert backwards.find(results).text.endswith("the rule is met")


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.quantity)
def test_claim_without_its_results_is_not_measured(results, claim):
    for name in claim.needs:
        rest = {key: value for key, value in results.items() if key != name}
        finding = claim.find(rest)
        assert finding.verdict is Verdict.MISSING
        assert name in finding.text


@pytest.mark.parametrize("claim", [*CLAIMS, *OWN_RESULTS], ids=lambda claim: claim.quantity)
def test_missing_figure_in_results_is_not_an_error(claim):
    empty = {name: {"drives": [], "table": [], "energy": []} for name in claim.needs}
    assert claim.find(empty).verdict is Verdict.MISSING


@pytest.mark.parametrize(("ratio", "said"), [(0.1, "agrees"), (0.101, "differs")])
@pytest.mark.parametrize("loops", ["P", "PI"])
def test_nearly_zero_means_at_most_a_tenth(results, loops, ratio, said):
    put(results, loops, 63.0, ratio, 1.0, 0.002, "paper")
    quantity = f"Coupling error at k = 2 as printed, {loops} loops"
    assert verdict(results, quantity) == said
    margin = f"the rule allows {0.1 / ratio:.1f} times that"
    assert margin in BY_NAME[quantity].find(results).text


@pytest.mark.parametrize(
    ("ratio", "met"), [(0.1, "the rule is met"), (0.101, "the rule is not met")]
)
@pytest.mark.parametrize(
    ("quantity", "rows"),
    [
        (
            "Coupling error at k = 2, J_a corrected",
            [("P", 2.0, "paper"), ("PI", 2.0, "paper")],
        ),
        ("Coupling error with this package's controller, P loops", [("P", 15.0, "package")]),
    ],
)
def test_another_controller_is_no_verdict_on_the_paper(results, quantity, rows, ratio, met):
    for loops, gain, controller in rows:
        put(results, loops, gain, ratio, 1.0, 0.002, controller)
    finding = BY_NAME[quantity].find(results)
    assert finding.verdict is Verdict.UNLIKE
    assert finding.text.endswith(met)


@pytest.mark.parametrize(
    ("peaks", "said"), [([0.01, 0.5], "agrees"), ([0.009, 0.5], "partly"), ([0.0, 0.0], "differs")]
)
def test_each_movement_must_stand_out(results, peaks, said):
    results["coupling"]["uncontrolled_rad"] = dict(enumerate(peaks))
    assert verdict(results, "Coupling error without control") == said


@pytest.mark.parametrize(("slip", "said"), [(19.9, "agrees"), (20.0, "differs")])
def test_control_must_reduce_slip(results, slip, said):
    put(results, "P", 63.0, 0.01, slip, 0.002, "paper")
    assert verdict(results, "Wheel slip") == said


@pytest.mark.parametrize(
    ("p", "pi", "said"),
    [(0.004, 0.004, "agrees"), (0.004, 0.006, "partly"), (0.006, 0.005, "differs")],
)
def test_odometry_must_gain_with_all_wheels(results, p, pi, said):
    put(results, "P", 63.0, 0.01, 8.0, p, "paper")
    put(results, "PI", 63.0, 0.01, 8.0, pi, "paper")
    assert verdict(results, "Odometry") == said


@pytest.mark.parametrize(("p50", "said"), [(8.1, "agrees"), (8.2, "differs"), (7.8, "differs")])
def test_setpoints_must_come_every_8_ms(results, p50, said):
    results["demo"]["arm"]["setpoints"]["p50_ms"] = p50
    results["bench_arm"]["streamer"]["p50_ms"] = p50
    assert verdict(results, "Setpoints of the arm, demo") == said
    assert verdict(results, "Setpoints of the arm, under load") == said


@pytest.mark.parametrize(("p99", "said"), [(99.0, "agrees"), (100.0, "differs")])
def test_slowest_of_three_cases_must_be_in_time(results, p99, said):
    results["moving"]["drives"] = [
        ride(cpu_p99_ms=p99),
        ride("the paper's horizon", cpu_p99_ms=p99),
    ]
    assert verdict(results, "Real time, defaults") == said
    assert verdict(results, "Real time, n = 10 steps of 0.1 s") == said


@pytest.mark.parametrize("fault", [{"reached": False, "time_s": None}, {"collided": True}])
def test_failed_drive_agrees_with_no_claim(results, fault):
    for name in ("corridor", "moving"):
        results[name]["drives"][0] = ride(**fault)
    assert verdict(results, "Three cases, defaults") == "partly"
    assert "corridor FAILED" in BY_NAME["Three cases, defaults"].find(results).text
    assert verdict(results, "Three cases, the paper's horizon") == "agrees"
    assert verdict(results, "Three cases, motor voltages as output") == "agrees"
    assert verdict(results, "Narrow corridor") == "differs"
    assert verdict(results, "Moving obstacles") == "differs"


@pytest.mark.parametrize(
    ("turned", "along", "said"),
    [
        (0.2, True, "agrees"),
        (0.2, False, "partly"),
        (0.1, True, "partly"),
        (0.1, False, "differs"),
    ],
)
def test_robot_must_turn_and_travel_along_a_diagonal_on_free_floor(results, turned, along, said):
    changes = {"peak_turn_rad": turned, "along_diagonal": along}
    results["free"]["drives"] = [ride(**changes)]
    assert verdict(results, "Free movement: heading, defaults") == said


@pytest.mark.parametrize(
    ("ratios", "said"),
    [([0.9, 0.99, None], "agrees"), ([0.9, 1.1], "partly"), ([1.0, 1.1], "differs")],
)
def test_energy_must_be_saved_to_every_goal(results, ratios, said):
    results["free"]["energy"] = [{"ratio": ratio} for ratio in ratios]
    assert verdict(results, "Free movement: energy, defaults") == said


@pytest.mark.parametrize(("turned", "said"), [(0.2, "agrees"), (0.1, "partly")])
def test_corridor_must_be_passed_turned(results, turned, said):
    results["corridor"]["drives"][0] = ride(peak_turn_rad=turned)
    assert verdict(results, "Narrow corridor") == said


@pytest.mark.parametrize(("share", "said"), [(0.0, "differs"), (0.1, "agrees")])
def test_backward_travel_is_recognised(results, share, said):
    results["corridor"]["drives"][0] = ride(backwards_share=share)
    assert verdict(results, "Narrow corridor: driving backwards") == said


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"other_collisions": 1}, "agrees"),
        ({"own_collisions": 1}, "differs"),
        ({"reached": 7}, "differs"),
        ({"reached": 7, "solvable": 7}, "agrees"),
    ],
)
def test_scenes_with_a_mismatched_robot_must_end_well(results, changes, said):
    results["scenes"]["groups"]["model off by up to 20 %"] = group(**changes)
    assert verdict(results, "Inexact model") == said


def paper_rides(results, **changes):
    """Replace the drives with the paper's problem: one as in `reproduced`, one changed."""
    results["free_paper"]["drives"][:2] = [paper_ride(600.0, 150.0), paper_ride(**changes)]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "agrees"),
        ({"peak_speed_s": 2.9}, "partly"),
        ({"way_shares": [0.2, 0.4, 0.89]}, "partly"),
    ],
)
def test_paper_speed_must_peak_early_and_end_slowly(results, changes, said):
    paper_rides(results, **changes)
    assert verdict(results, "Free movement: speed, the paper's problem") == said


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "agrees"),
        ({"turn_to_diagonal_rad": -0.4}, "partly"),
        ({"along_diagonal": False}, "partly"),
        ({"rest_rad": 0.4}, "partly"),
    ],
)
def test_paper_robot_must_turn_to_a_diagonal_and_back_with_all_weights(results, changes, said):
    paper_rides(results, **changes)
    assert verdict(results, "Free movement: heading, the paper's problem") == said


@pytest.mark.parametrize(("rest", "said"), [(0.29, "agrees"), (0.31, "partly")])
def test_paper_robot_must_rest_near_its_goal(results, rest, said):
    paper_rides(results, rest_m=rest)
    assert verdict(results, "Free movement: goal, the paper's problem") == said


@pytest.mark.parametrize(
    ("changes", "said"),
    [({}, "agrees"), ({"compared_j": 229.0}, "differs"), ({"compared_s": 3.8}, "differs")],
)
def test_turning_must_save_energy_without_taking_longer(results, changes, said):
    paper_rides(results, **changes)
    assert verdict(results, "Free movement: energy, the paper's problem") == said
