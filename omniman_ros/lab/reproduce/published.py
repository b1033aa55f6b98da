"""The claims of the two papers, how each is measured here, and what counts as agreement.

Papers: C. Röhrig, D. Heß and F. Künemund, "Motion Controller Design for a Mecanum Wheeled Mobile
Manipulator", CCTA 2017; I. Moreno-Caireta, E. Celaya and L. Ros, "Model Predictive Control for a
Mecanum-wheeled Robot Navigating among Obstacles", 2021. Both show pictures and few numbers, and
use robots of their own: most of what can be compared is a claim, whose rule is this package's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from omniman_ros.lab.reproduce.findings import (
    CASES,
    DISTINGUISHABLE,
    PAPER_PLANNER,
    SETPOINT_PERIOD,
    SETPOINT_TOLERANCE,
    STAGE,
    TURNED,
    VOLTAGES,
    Finding,
    Results,
    Verdict,
    along_diagonal,
    arrives,
    duration,
    economy,
    evasion,
    friction,
    in_reverse,
    in_step,
    in_time,
    inexact,
    odometry,
    passage,
    remaining,
    rooms,
    setpoints,
    slip,
    uncontrolled,
)
from omniman_ros.lab.studies.coupling_sweep import AIM, PAPER_GAIN

CCTA, MPC = "CCTA 2017", "MPC 2021"


@dataclass(frozen=True)
class Claim:
    """A claim, which is a row of the comparison.

    Attributes:
        quantity: Quantity that is compared.
        source: Paper, section and figure; empty for figures that only this package has.
        published: What the source says; empty for figures that only this package has.
        needs: Experiments whose results are needed.
        measure: Computes the finding from their results.
        rule: What counts as agreement; empty where the source gives nothing to judge by.
        note: What the reader should know.
    """

    quantity: str
    source: str
    published: str
    needs: tuple[str, ...]
    measure: Callable[[Results], Finding] = field(repr=False)
    rule: str = ""
    note: str = ""

    def find(self, results: Results) -> Finding:
        """Return the finding; its verdict is MISSING where results or figures are missing."""
        absent = [name for name in self.needs if name not in results]
        if absent:
            return Finding({}, f"no result of {', '.join(absent)}", Verdict.MISSING)
        try:
            return self.measure(results)
        except (LookupError, TypeError, ValueError):  # a figure is missing, null or empty
            return Finding({}, "not among what was driven", Verdict.MISSING)


OWN_SCENES = "the layout is this package's: the paper has pictures only"
CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Coupling error without control",
        f"{CCTA}, V.C, Fig. 7 (red)",
        "not zero; the five movements are easily distinguished (a curve, no numbers)",
        ("coupling",),
        uncontrolled,
        f"each of the five movements changes ε by {DISTINGUISHABLE:g} rad or more",
        "mean over wheels drawn at random; their real spread is not published",
    ),
    Claim(
        f"Coupling error at k = {PAPER_GAIN:g}, P loops",
        f"{CCTA}, V.C, Fig. 7 (blue)",
        "reduced nearly to zero",
        ("coupling",),
        remaining("P", own=False),
        f"at most {AIM:g} of that without control",
        "wheels on the floor hold each other, so that ε settles much more slowly than 1/k",
    ),
    Claim(
        f"The same, PI loops at k = {PAPER_GAIN:g}",
        f"{CCTA}, V.C, Fig. 7 (blue)",
        "reduced nearly to zero",
        ("coupling",),
        remaining("PI", own=False),
        f"at most {AIM:g} of that without control",
        "which velocity loops is not published",
    ),
    Claim(
        "The same, P loops at this robot's gain",
        f"{CCTA}, V.C, Fig. 7 (blue)",
        f"reduced nearly to zero, at k = {PAPER_GAIN:g}",
        ("coupling",),
        remaining("P", own=True),
        f"at most {AIM:g} of that without control",
        "the gain was chosen for that",
    ),
    Claim(
        "Wheel slip",
        f"{CCTA}, V.C",
        "the coupling error leads to additional slippage",
        ("coupling",),
        slip,
        "less slip losses with control than without",
    ),
    Claim(
        "Odometry",
        f"{CCTA}, V.C",
        "that slippage decreases its accuracy",
        ("coupling",),
        odometry,
        f"largest error smaller at k = {PAPER_GAIN:g} than without control, for all wheels",
    ),
    Claim(
        "Platform and arm in step",
        f"{CCTA}, V.A, Fig. 5",
        "movements in step at joint level, in real time (no experiment)",
        ("tool_path",),
        in_step,
        note="in odometry's frame, servo of the simulated controller",
    ),
    Claim(
        "Setpoints of the arm, demo",
        f"{CCTA}, V.A",
        "streamed every 8 ms over a TCP socket",
        ("demo",),
        setpoints("demo", "arm", "setpoints"),
        f"median within {SETPOINT_TOLERANCE:g} ms of {SETPOINT_PERIOD:g} ms",
        "a simulated UR5 controller",
    ),
    Claim(
        "Setpoints of the arm, under load",
        f"{CCTA}, V.A",
        "streamed every 8 ms over a TCP socket",
        ("bench_arm",),
        setpoints("bench_arm", "streamer"),
        f"median within {SETPOINT_TOLERANCE:g} ms of {SETPOINT_PERIOD:g} ms",
        "a simulated UR5 controller",
    ),
    Claim(
        "Real time, n = 10 steps of 0.1 s",
        f"{MPC}, 4",
        "fulfils the time constraints of real time (no times; interior point solver)",
        CASES,
        in_time(PAPER_PLANNER),
        f"p99 below {1e3 * STAGE:g} ms, the paper's stage",
        "whole cycle, this machine, another solver",
    ),
    Claim(
        "Real time, defaults",
        f"{MPC}, 4",
        "n = 10: one second ahead, chosen for real time",
        CASES,
        in_time("defaults"),
        f"p99 below {1e3 * STAGE:g} ms",
        "two seconds ahead by default, n = 20",
    ),
    Claim(
        "Three cases with n = 10 and its cost",
        f"{MPC}, 4.1 to 4.3, Fig. 4, 5, video",
        "all goals reached, nothing touched",
        CASES,
        arrives(PAPER_PLANNER),
        "the same in all three",
        OWN_SCENES,
    ),
    Claim(
        "Three cases, defaults",
        f"{MPC}, 4.1 to 4.3, Fig. 4, 5, video",
        "all goals reached, nothing touched",
        CASES,
        arrives("defaults"),
        "the same in all three",
        OWN_SCENES,
    ),
    Claim(
        "Three cases, motor voltages put out",
        f"{MPC}, 2.2, (20)",
        "what is planned and put out are voltages",
        CASES,
        arrives(VOLTAGES),
        "all goals reached, nothing touched",
        "with n = 20; else a reference is put out",
    ),
    Claim(
        "Free movement: time",
        f"{MPC}, 4.1, Fig. 4",
        "at the goal two seconds after the last snapshot at 7 s (its distance is not published)",
        ("free",),
        duration,
        note="a distance of our own, so no like for like",
    ),
    Claim(
        "Free movement: heading, defaults",
        f"{MPC}, 4.1, Fig. 4",
        "turns on the way, to travel diagonally, and back",
        ("free",),
        along_diagonal("defaults"),
        f"turns by {math.degrees(TURNED):.0f}° or more; mostly within 10° of a diagonal",
    ),
    Claim(
        "Free movement: the same, n = 10 and its cost",
        f"{MPC}, 4.1, Fig. 4",
        "turns on the way, to travel diagonally, and back",
        ("free",),
        along_diagonal(PAPER_PLANNER),
        f"turns by {math.degrees(TURNED):.0f}° or more; mostly within 10° of a diagonal",
        "one second ahead is short for it here; weights are not published",
    ),
    Claim(
        "Free movement: energy",
        f"{MPC}, 3.2, 4.1",
        "turning is a way to take less energy (no numbers)",
        ("free",),
        economy,
        "less than the straight line in one heading that arrives as late, for every goal",
        "electric energy until rest; the line's speed is limited, its profile smooth",
    ),
    Claim(
        "Narrow corridor",
        f"{MPC}, 4.2, Fig. 5",
        "through gaps narrower than the robot is long, turning as necessary",
        ("corridor",),
        passage,
        f"through without contact, turned by {math.degrees(TURNED):.0f}° or more",
        OWN_SCENES,
    ),
    Claim(
        "Narrow corridor: backwards",
        f"{MPC}, 4.2, Fig. 5",
        "turns clockwise and crosses the opening backwards",
        ("corridor",),
        in_reverse,
        "a part of the way is backwards",
        OWN_SCENES + "; here there is no need to",
    ),
    Claim(
        "Moving obstacles",
        f"{MPC}, 4.3, video",
        "four cross, the third blocks the path; each is avoided by planning anew",
        ("moving",),
        evasion,
        "goal reached without contact",
        OWN_SCENES,
    ),
    Claim(
        "Model not exact",
        f"{MPC}, 1, 3",
        "small inaccuracies of the model are mitigated by planning anew (no experiment)",
        ("scenes",),
        inexact,
        "random scenes, robot up to 20 % off: all goals reached that can be, no contact of ours",
    ),
    Claim(
        "Friction of the wheels",
        f"{MPC}, 2, (24)",
        "a and b found at constant voltages (no numbers; another robot)",
        ("identify_friction",),
        friction,
        note="simulated wheels, on blocks",
    ),
    Claim(
        "Workshop with dead end",
        f"{MPC}, 5",
        "proposed as an application (no experiment)",
        ("workshop",),
        rooms,
    ),
)
"""The claims, in the order in which they are shown."""
