import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.console.errors import CommandError
from omniman_ros.lab.bench.faults import chosen_rows, row_figures, summary
from omniman_ros.lab.faults import page
from omniman_ros.lab.faults.driver import cruise
from omniman_ros.lab.faults.injections import InvalidContent, Publication, Setting
from omniman_ros.lab.faults.invalid_messages import TOPICS
from omniman_ros.lab.faults.judge import StopMeasurement
from omniman_ros.lab.faults.rows import RequiredOutcome
from omniman_ros.lab.faults.table import ROWS
from omniman_ros.lab.faults.trial import LONGEST_HOLD_UP, Trial
from omniman_ros.nodes.registry import node_specs


def test_names_are_unique_and_each_row_is_on_the_page():
    names = [row.name for row in ROWS]
    assert len(set(names)) == len(names)
    text = "\n".join(page.markdown())
    assert all(f"| {name} |" in text for name in names)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_each_injection_names_what_its_node_and_the_publishers_know(row):
    injection = row.injection
    if isinstance(injection, Setting):
        assert injection.parameter in {spec.name for spec in node_specs(injection.node)}
    if isinstance(injection, Publication):
        assert injection.topic in TOPICS


@pytest.mark.parametrize("topic", TOPICS)
@pytest.mark.parametrize("content", InvalidContent)
def test_an_invalid_message_has_the_type_of_its_topic(topic, content):
    kind, make = TOPICS[topic]
    assert isinstance(make(content), kind)


def test_rows_are_checked():
    latched = next(row for row in ROWS if row.outcome is RequiredOutcome.LATCHED)
    with pytest.raises(ValueError, match="nobody is named"):
        replace(latched, stopped=())
    with pytest.raises(ValueError, match="needs its name"):
        replace(latched, unnoticed=1.0, timeout="")


def test_rows_are_chosen_by_name_in_the_order_of_the_table():
    names = [ROWS[5].name, ROWS[2].name]
    assert [row.name for row in chosen_rows(names)] == names[::-1]
    assert len(chosen_rows([])) == len(ROWS)
    with pytest.raises(CommandError, match="there is no such row"):
        chosen_rows(["nothing"])


def test_a_cruise_begins_and_ends_at_rest_and_its_speed_is_the_derivative_of_its_way():
    times, ways, speeds = cruise(1.2, 4.0, 0.01)
    assert (speeds[0], speeds[-1], ways[0]) == (0.0, 0.0, 0.0)
    assert ways[-1] == pytest.approx(1.2 + 4.0)
    assert np.gradient(ways, times)[1:-1] == pytest.approx(speeds[1:-1], abs=2e-4)
    assert speeds[(times > 1.2) & (times < 5.2)] == pytest.approx(1.0)


def test_the_report_counts_reactions_from_the_evidence_on():
    row = next(row for row in ROWS if row.name == "drive silent")
    stop = StopMeasurement(0.5, row.unnoticed + 0.05, 0.6, 1.2, 0.5)
    figures = row_figures(row, [Trial(stop, stop, []), Trial(stop, stop, [])])
    assert figures["platform_reaction_s"] == pytest.approx(0.05)
    assert figures["passed"]
    result = summary([figures])
    assert result["reaction_p99_s"] == pytest.approx(0.05)
    assert result["aims"] == {"rows": True, "reaction": True}
    late = replace(stop, reaction=math.inf)
    figures = row_figures(row, [Trial(late, stop, ["platform: reaction"])])
    result = summary([figures])
    assert result["failed"] == ["drive silent"]
    assert result["aims"] == {"rows": False, "reaction": False}


@pytest.mark.parametrize("failures", [[], ["platform: reaction"]])
def test_a_trial_that_the_machine_held_up_is_not_judged_whether_it_passed_or_failed(failures):
    row = next(row for row in ROWS if row.name == "drive silent")
    quick = StopMeasurement(0.5, row.unnoticed + 0.05, 0.6, 1.2, 0.5)
    held = Trial(replace(quick, reaction=9.0), quick, failures, held_up=LONGEST_HOLD_UP + 0.001)
    figures = row_figures(row, [held, held])
    assert (figures["passed"], figures["failures"], figures["not_judged"]) == (None, [], 2)
    result = summary([figures])
    assert (result["failed"], result["not_judged"]) == ([], 2)
    assert result["aims"] == {"rows": None, "reaction": None}
    judged = Trial(quick, quick, [], held_up=LONGEST_HOLD_UP)
    figures = row_figures(row, [held, judged])
    assert (figures["passed"], figures["platform_reaction_s"]) == (True, pytest.approx(0.05))
    failed = summary(
        [row_figures(row, [held]), row_figures(row, [replace(judged, failures=["x"])])]
    )
    assert failed["aims"]["rows"] is False
