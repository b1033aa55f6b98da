"""The claims of the two papers, how each is measured here, and what counts as agreement.

Papers: C. Röhrig, D. Heß and F. Künemund, "Motion Controller Design for a Mecanum Wheeled Mobile
Manipulator", CCTA 2017; I. Moreno-Caireta, E. Celaya and L. Ros, "Model Predictive Control for a
Mecanum-wheeled Robot Navigating among Obstacles", 2021. Both print many pictures and few numbers,
and use different robots. What can be compared is therefore mostly qualitative claims; the rules of
agreement are this package's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from omniman_ros.lab.reproduce.findings import (
    CASES,
    DISTINGUISHABLE,
    LATE_SHARE,
    MIN_TURN,
    NEAR_GOAL,
    PAPER_HORIZON,
    SETPOINT_PERIOD,
    SETPOINT_TOLERANCE,
    STAGE_DURATION,
    TURNED_BACK,
    VOLTAGES,
    Finding,
    Results,
    Verdict,
    backward_travel,
    corridor_passage,
    diagonal_travel,
    energy_ratio,
    free_duration,
    goals_reached,
    model_mismatch,
    moving_obstacles,
    odometry_error,
    paper_energy,
    paper_goal,
    paper_heading,
    planning_time,
    remaining_as_printed,
    remaining_corrected,
    remaining_own,
    setpoint_interval,
    side_by_side,
    slip_losses,
    speed_profile,
    tool_tracking,
    uncontrolled_error,
    wheel_friction,
    workshop_drive,
)
from omniman_ros.lab.studies.coupling_sweep import AIM, PAPER_GAIN

CCTA, MPC = "CCTA 2017", "MPC 2021"
"""Short names of the papers."""


RULE_OUTCOMES = {
    Verdict.AGREES: "met",
    Verdict.PARTLY: "met in part",
    Verdict.DIFFERS: "not met",
}
"""Whether a rule is met, for claims whose conditions are not the paper's."""


@dataclass(frozen=True)
class Claim:
    """A published claim with its evaluation: one row of the comparison.

    Attributes:
        quantity: Quantity that is compared; unique.
        source: Paper, section and figure; empty for results that only this package has.
        published: Statement of the source; empty for results that only this package has.
        needs: Names of the experiments whose results are needed.
        measure: Function that evaluates the results.
        rule: Rule of agreement; empty if the source gives nothing to compare with.
        note: Remark for the reader.
        unlike: What keeps the comparison from being like for like; empty if nothing does. The
            verdict is then UNLIKE, and the text says whether the rule is met.
    """

    quantity: str
    source: str
    published: str
    needs: tuple[str, ...]
    measure: Callable[[Results], Finding] = field(repr=False)
    rule: str = ""
    note: str = ""
    unlike: str = ""

    def find(self, results: Results) -> Finding:
        """Evaluate the results; the verdict is MISSING if a result, or a value in it, is missing.

        Args:
            results: JSON of the experiments, by name.
        """
        absent = [name for name in self.needs if name not in results]
        if absent:
            return Finding({}, f"no result of {', '.join(absent)}", Verdict.MISSING)
        try:
            finding = self.measure(results)
        except (LookupError, TypeError, ValueError):  # a value is missing, null or empty
            return Finding({}, "not among the drives of this run", Verdict.MISSING)
        if not self.unlike or finding.verdict not in RULE_OUTCOMES:
            return finding
        text = f"{finding.text}; the rule is {RULE_OUTCOMES[finding.verdict]}"
        return replace(finding, text=text, verdict=Verdict.UNLIKE)


OWN_SCENES = "layout, limits, weights and robot are this package's: the paper has pictures only"
"""What keeps drives through the cases of MPC 2021 from being like for like."""
OWN_PROBLEM = "speed and acceleration limits, running cost and horizon are this package's"
"""What keeps the default planner from being like for like with MPC 2021, 4.1."""
PAPER_SETTING = "weights, friction, mass and bearing are not published, and varied here"
"""Note on drives with the problem of MPC 2021 itself."""
OWN_SOLVER = "this machine, another solver, and the layouts of this package"
"""What keeps the planner's times from being like for like with MPC 2021."""
AS_PRINTED = "(18) as printed: k = 2 acts like 2 * 4 / r; (24) from 0 to t, (25), no bound"
"""Note on the paper's coupling controller."""
CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Coupling error without control",
        f"{CCTA}, V.C, Fig. 7 (red)",
        "not zero; the five movements are easily distinguished (a curve, no numbers)",
        ("coupling",),
        uncontrolled_error,
        f"each of the five movements changes ε by {DISTINGUISHABLE:g} rad or more",
        "mean over random wheels; the spread of the real ones is not published",
    ),
    Claim(
        f"Coupling error at k = {PAPER_GAIN:g} as printed, P loops",
        f"{CCTA}, V.C, Fig. 7 (blue)",
        "reduced nearly to zero",
        ("coupling",),
        remaining_as_printed("P"),
        f"at most {AIM:g} of that without control",
        AS_PRINTED,
    ),
    Claim(
        f"Coupling error at k = {PAPER_GAIN:g} as printed, PI loops",
        f"{CCTA}, V.C, Fig. 7 (blue)",
        "reduced nearly to zero",
        ("coupling",),
        remaining_as_printed("PI"),
        f"at most {AIM:g} of that without control",
        AS_PRINTED + "; the kind of velocity loop is not published",
    ),
    Claim(
        f"Coupling error at k = {PAPER_GAIN:g}, J_a corrected",
        f"{CCTA}, V.C, Fig. 7 (blue)",
        "reduced nearly to zero",
        ("coupling",),
        remaining_corrected,
        f"at most {AIM:g} of that without control",
        "wheels on the floor constrain each other, so that ε settles much more slowly than 1/k",
        unlike="the correction is r/4 of that: another controller than the equations describe",
    ),
    Claim(
        "Coupling error with this package's controller, P loops",
        f"{CCTA}, V.C, Fig. 7 (blue)",
        f"reduced nearly to zero, at k = {PAPER_GAIN:g}",
        ("coupling",),
        remaining_own,
        f"at most {AIM:g} of that without control",
        "the gain was chosen to meet this rule",
        unlike="another gain, J_a corrected, and reset at each rest",
    ),
    Claim(
        "Wheel slip",
        f"{CCTA}, V.C",
        "the coupling error leads to additional slippage",
        ("coupling",),
        slip_losses,
        "lower slip losses with control than without, P loops",
        AS_PRINTED,
    ),
    Claim(
        "Odometry",
        f"{CCTA}, V.C",
        "the additional slippage decreases its accuracy",
        ("coupling",),
        odometry_error,
        "the largest error is smaller with control than without, P and PI loops",
        AS_PRINTED,
    ),
    Claim(
        "Coordinated motion of platform and arm",
        f"{CCTA}, V.A, Fig. 5",
        "motion coordinated at joint level, in real time (no experiment)",
        ("tool_path",),
        tool_tracking,
        note="in odom, with the servo of the simulated arm controller",
    ),
    Claim(
        "Setpoints of the arm, demo",
        f"{CCTA}, V.A",
        "streamed every 8 ms over a TCP socket",
        ("demo",),
        setpoint_interval("demo", "arm", "setpoints"),
        f"median within {SETPOINT_TOLERANCE:g} ms of {SETPOINT_PERIOD:g} ms",
        "a simulated UR5 controller",
    ),
    Claim(
        "Setpoints of the arm, under load",
        f"{CCTA}, V.A",
        "streamed every 8 ms over a TCP socket",
        ("bench_arm",),
        setpoint_interval("bench_arm", "streamer"),
        f"median within {SETPOINT_TOLERANCE:g} ms of {SETPOINT_PERIOD:g} ms",
        "a simulated UR5 controller",
    ),
    Claim(
        "Real time, n = 10 steps of 0.1 s",
        f"{MPC}, 4",
        "meets real-time constraints (no times; interior-point solver)",
        CASES,
        planning_time(PAPER_HORIZON),
        f"p99 below {1e3 * STAGE_DURATION:g} ms, the duration of the paper's stage",
        "whole cycle",
        unlike=OWN_SOLVER,
    ),
    Claim(
        "Real time, defaults",
        f"{MPC}, 4",
        "n = 10, a horizon of one second, was chosen for real time",
        CASES,
        planning_time("defaults"),
        f"p99 below {1e3 * STAGE_DURATION:g} ms",
        "the default horizon is two seconds, n = 20",
        unlike=OWN_SOLVER,
    ),
    Claim(
        "Three cases, the paper's horizon",
        f"{MPC}, 4.1 to 4.3, Fig. 4, 5, video",
        "all goals reached, nothing touched",
        CASES,
        goals_reached(PAPER_HORIZON),
        "the same in all three",
        unlike=OWN_SCENES,
    ),
    Claim(
        "Three cases, defaults",
        f"{MPC}, 4.1 to 4.3, Fig. 4, 5, video",
        "all goals reached, nothing touched",
        CASES,
        goals_reached("defaults"),
        "the same in all three",
        unlike=OWN_SCENES,
    ),
    Claim(
        "Three cases, motor voltages as output",
        f"{MPC}, 2.2, (20)",
        "motor voltages are planned and applied",
        CASES,
        goals_reached(VOLTAGES),
        "all goals reached, nothing touched",
        "with n = 20; by default, the output is a reference motion",
        OWN_SCENES,
    ),
    Claim(
        "Free movement: speed, the paper's problem",
        f"{MPC}, 4.1, Fig. 4",
        "starts fast, and slows down near the goal",
        ("free_paper",),
        speed_profile,
        f"peak in the first half of the time, at most {100 * LATE_SHARE:g} % of the path in the "
        "last 2/9 (the paper's last 2 of 9 s)",
        PAPER_SETTING,
    ),
    Claim(
        "Free movement: heading, the paper's problem",
        f"{MPC}, 4.1, Fig. 4",
        "turns in order to travel diagonally, then turns back",
        ("free_paper",),
        paper_heading,
        f"turns by {math.degrees(MIN_TURN):.0f}° or more to a diagonal, mostly within 10° of it, "
        f"{math.degrees(TURNED_BACK):.0f}° or less left at rest, with all weights",
        "turns to it where Coulomb friction counts and voltages are mostly below their limit; "
        "at the limit it turns away from it, to the axis of the largest thrust",
    ),
    Claim(
        "Free movement: goal, the paper's problem",
        f"{MPC}, 4.1, Fig. 4",
        "drives to the goal, in two more seconds after the last snapshot at 7 s",
        ("free_paper",),
        paper_goal,
        f"rests within {100 * NEAR_GOAL:g} % of the distance, with all weights",
        "friction stops it where the rest of the way costs more than it gains; the distance is "
        "not published, so the times are not comparable",
    ),
    Claim(
        "Free movement: energy, the paper's problem",
        f"{MPC}, 3.2, 4.1",
        "turning saves energy (no numbers)",
        ("free_paper",),
        paper_energy,
        "less for the same path and not later than with the heading held",
        PAPER_SETTING,
    ),
    Claim(
        "Free movement: time, defaults",
        f"{MPC}, 4.1, Fig. 4",
        "at the goal two seconds after the last snapshot at 7 s (distance not published)",
        ("free",),
        free_duration,
        note="the distance is this package's, so the times are not comparable",
    ),
    Claim(
        "Free movement: heading, defaults",
        f"{MPC}, 4.1, Fig. 4",
        "turns in order to travel diagonally, then turns back",
        ("free",),
        diagonal_travel("defaults"),
        f"turns by {math.degrees(MIN_TURN):.0f}° or more; mostly within 10° of a diagonal",
        unlike=OWN_PROBLEM,
    ),
    Claim(
        "Free movement: energy, defaults",
        f"{MPC}, 3.2, 4.1",
        "turning saves energy (no numbers)",
        ("free",),
        energy_ratio,
        "less than a straight line at constant heading with equal arrival time, for every goal",
        "electric energy until rest; the line has a limited speed and a smooth profile",
        OWN_PROBLEM,
    ),
    Claim(
        "Narrow corridor",
        f"{MPC}, 4.2, Fig. 5",
        "passes gaps narrower than the robot is long, turning as necessary",
        ("corridor",),
        corridor_passage,
        f"passed without contact, turned by {math.degrees(MIN_TURN):.0f}° or more",
        unlike=OWN_SCENES,
    ),
    Claim(
        "Narrow corridor: driving backwards",
        f"{MPC}, 4.2, Fig. 5",
        "turns clockwise and crosses the opening backwards",
        ("corridor",),
        backward_travel,
        "backwards for a part of the time",
        "this layout does not require driving backwards",
        OWN_SCENES,
    ),
    Claim(
        "Moving obstacles",
        f"{MPC}, 4.3, video",
        "four cross the path, the third blocks it; each is avoided by replanning",
        ("moving",),
        moving_obstacles,
        "goal reached without contact",
        unlike=OWN_SCENES,
    ),
    Claim(
        "Inexact model",
        f"{MPC}, 1, 3",
        "replanning mitigates small inaccuracies of the model (no experiment)",
        ("scenes",),
        model_mismatch,
        "random scenes, robot up to 20 % off: all reachable goals reached, no avoidable contact",
    ),
    Claim(
        "Load between two robots in motion",
        f"{MPC}, 5",
        "a load could be transferred between two robots that move in parallel (no experiment)",
        ("handover",),
        side_by_side,
        note="the node station_keeper, which knows only the odometry of the other robot",
    ),
    Claim(
        "Friction of the wheels",
        f"{MPC}, 2, (24)",
        "a and b identified at constant voltages (no numbers; another robot)",
        ("identify_friction",),
        wheel_friction,
        note="simulated wheels, off the floor",
    ),
    Claim(
        "Workshop with a dead end",
        f"{MPC}, 5",
        "proposed as an application (no experiment)",
        ("workshop",),
        workshop_drive,
    ),
)
"""Claims in the order in which they are shown."""
