"""The table of faults: each row names a fault and what must happen then.

`omniman bench faults` plays the rows against a robot of its own, `omniman fault` injects one
into a simulation that runs, and the documentation shows them.
"""

from dataclasses import dataclass, replace
from signal import SIGKILL, SIGSTOP, Signals
from typing import Any

from omniman_ros.lab.faults.injections import (
    ARM,
    BRIDGE,
    CONTROLLER,
    DRIVES,
    INTERPOLATOR,
    MONITOR,
    STREAMER,
    STREAMING_PROCESS,
    EmergencyStop,
    Injection,
    InvalidContent,
    Publication,
    Restart,
    Second,
    ServiceStop,
    Setting,
    Signal,
    TwistFault,
)
from omniman_ros.lab.faults.rows import GoingOn, MotionKind, RequiredOutcome, Row, Subject

FRONT_LEFT = ("front_left",)  #: wheel whose drive fails
PROCESS_NAMES = {STREAMING_PROCESS: "The streaming process of `arm_streamer`"}
AFTER_SUSPENSION = {
    RequiredOutcome.LATCHED: GoingOn.RESET,
    RequiredOutcome.ENDED: GoingOn.COMMAND,
    RequiredOutcome.PAUSED: GoingOn.NOTHING,
}  #: What a user does to drive on once a suspended process goes on
LOST_SOURCE = 0.1  #: longest time from the evidence of a lost source until the robot brakes [s]
SOURCE_LOST: dict[str, Any] = {"reaction": LOST_SOURCE, "source": "none"}


@dataclass(frozen=True)
class Timeout:
    """A time-out by which a fault becomes evident."""

    unnoticed: float  #: [s]
    timeout: str  #: what sets it, mostly a parameter


AT_ONCE = Timeout(0.0, "")
CMD_VEL = Timeout(0.5, "timeouts.cmd_vel")
HORIZON = Timeout(0.4, "horizon")
ODOM_PAUSE = Timeout(0.1, "odom_pause")
WHEEL_STATES = Timeout(0.2, "timeouts.wheel_states")
ARM_STATES = Timeout(0.2, "joint_trajectory.states_timeout")
ARM_FEEDBACK = Timeout(0.1, "ur.feedback_timeout")
MOTION_LIMIT = Timeout(0.2, "collision_monitor.timeout")
MISSED_REPORTS = Timeout(0.06, "can.missed_periods")


def _latched(
    name: str,
    subject: Subject,
    fault: str,
    injection: Injection,
    stopped: tuple[str, ...],
    late: Timeout = AT_ONCE,
    going_on: GoingOn = GoingOn.RESET,
    **more: Any,
) -> Row:
    """Return the row of a fault that stops a trajectory of platform and arm until a reset."""
    return Row(
        name,
        subject,
        fault,
        injection,
        RequiredOutcome.LATCHED,
        going_on,
        MotionKind.TRAJECTORY,
        late.unnoticed,
        late.timeout,
        stopped=stopped,
        **more,
    )


def _process(
    label: str,
    process: str,
    number: Signals,
    late: Timeout = AT_ONCE,
    outcome: RequiredOutcome = RequiredOutcome.ENDED,
    stopped: tuple[str, ...] = (),
    **more: Any,
) -> Row:
    """Return the row of a process that is killed, or suspended until after the judgement."""
    subject = PROCESS_NAMES.get(process, f"`{process}`")
    if number is SIGKILL:
        name, fault, going_on = f"{label} killed", f"{subject} is killed.", GoingOn.RESTART
    else:
        name, fault = (
            f"{label} suspended",
            f"{subject} is suspended, and goes on after the judgement.",
        )
        going_on = AFTER_SUSPENSION[outcome]
    row = Row(
        name,
        Subject.PROCESS,
        fault,
        Signal(process, number),
        outcome,
        going_on,
        MotionKind.TWIST if outcome is RequiredOutcome.PAUSED else MotionKind.TRAJECTORY,
        late.unnoticed,
        late.timeout,
        stopped=stopped,
    )
    return replace(row, **more)


def _twist(name: str, fault: str, injection: TwistFault) -> Row:
    """Return the row of a source of twists that is lost."""
    return Row(
        name,
        Subject.SOURCE,
        fault,
        injection,
        RequiredOutcome.PAUSED,
        GoingOn.COMMAND,
        MotionKind.TWIST,
        CMD_VEL.unnoticed,
        CMD_VEL.timeout,
        LOST_SOURCE,
        arm=False,
        source="none",
    )


def _harmless(
    name: str,
    subject: Subject,
    fault: str,
    injection: Injection,
    outcome: RequiredOutcome = RequiredOutcome.UNHARMED,
) -> Row:
    """Return the row of a fault that must not stop the robot."""
    nothing = GoingOn.NOTHING
    return Row(name, subject, fault, injection, outcome, nothing, platform=False, arm=False)


def _drive(name: str, fault: str, parameter: str, late: Timeout = AT_ONCE) -> Row:
    """Return the row of a drive that fails."""
    injection = Setting(DRIVES, f"can_faults.{parameter}", FRONT_LEFT, ())
    return _latched(name, Subject.DRIVE, fault, injection, (BRIDGE,), late)


def _arm(name: str, fault: str, parameter: str, late: Timeout = AT_ONCE, **more: Any) -> Row:
    """Return the row of a fault of the arm's controller or of the connection to it."""
    injection = Setting(ARM, f"faults.{parameter}", True, False)
    return _latched(name, Subject.ARM, fault, injection, (STREAMER,), late, **more)


ROWS = (
    _twist("cmd_vel silent", "The publisher of `cmd_vel` falls silent.", TwistFault.SILENT),
    _twist("cmd_vel NaN", "`cmd_vel` is NaN from now on.", TwistFault.NAN),
    _twist("cmd_vel infinite", "`cmd_vel` is infinite from now on.", TwistFault.INFINITE),
    _harmless(
        "cmd_vel jump",
        Subject.SOURCE,
        "`cmd_vel` is a hundred times too fast: speed and acceleration keep to the limits.",
        TwistFault.JUMP,
        RequiredOutcome.LIMITED,
    ),
    _harmless(
        "cmd_vel twice",
        Subject.SOURCE,
        "Two publishers of `cmd_vel` contradict each other: the limits hold.",
        TwistFault.OPPOSED,
        RequiredOutcome.LIMITED,
    ),
    _harmless(
        "cmd_vel flood", Subject.SOURCE, "`cmd_vel` comes 1000 times a second.", TwistFault.FLOOD
    ),
    _process("interpolator", INTERPOLATOR, SIGKILL, HORIZON, **SOURCE_LOST),
    _process(
        "interpolator",
        INTERPOLATOR,
        SIGSTOP,
        HORIZON,
        fault="`path_interpolator` is suspended for 1 s, and goes on.",
        injection=Signal(INTERPOLATOR, SIGSTOP, resume=1.0),
        **SOURCE_LOST,
    ),
    _process("controller", CONTROLLER, SIGKILL, ODOM_PAUSE, slowly=1.6),
    _process("controller", CONTROLLER, SIGSTOP, ODOM_PAUSE, slowly=1.6),
    _process(
        "controller",
        CONTROLLER,
        SIGKILL,
        ODOM_PAUSE,
        name="controller restarted",
        fault="`platform_controller` is killed in motion, and started again at once.",
        injection=Restart(CONTROLLER),
        going_on=GoingOn.COMMAND,
        slowly=1.6,
    ),
    _process("bridge", BRIDGE, SIGKILL, WHEEL_STATES, RequiredOutcome.LATCHED, (CONTROLLER,)),
    _process("bridge", BRIDGE, SIGSTOP, WHEEL_STATES, RequiredOutcome.LATCHED, (CONTROLLER,)),
    _harmless(
        "bridge twice",
        Subject.PROCESS,
        "A second `can_bridge` is started on the same bus: it leaves the drives alone.",
        Second(BRIDGE),
    ),
    _process("streamer", STREAMER, SIGKILL, ARM_STATES, slowly=1.5),
    _process(
        "streaming process",
        STREAMING_PROCESS,
        SIGKILL,
        outcome=RequiredOutcome.LATCHED,
        stopped=(STREAMER,),
        going_on=GoingOn.RESET,
    ),
    _process(
        "streaming process",
        STREAMING_PROCESS,
        SIGSTOP,
        Timeout(0.5, "the streamer waits for its process"),
        RequiredOutcome.LATCHED,
        (STREAMER,),
    ),
    _latched(
        "arm controller killed",
        Subject.ARM,
        "The arm's controller is gone.",
        Signal(ARM, SIGKILL),
        (STREAMER,),
        going_on=GoingOn.RESTART,
        arm=False,
    ),
    _arm(
        "arm protective stop", "The arm's controller makes a protective stop.", "protective_stop"
    ),
    _latched(
        "arm emergency stop",
        Subject.ARM,
        "The emergency stop of the arm's pendant is pressed.",
        Setting(ARM, "faults.emergency_stop", True, False, ("power on", "brake release")),
        (STREAMER,),
        going_on=GoingOn.PENDANT,
    ),
    _arm("arm program paused", "The program is paused at the pendant.", "pause_program"),
    _arm(
        "arm data frozen",
        "The controller's data stop; the connections stay.",
        "freeze_rtde",
        ARM_FEEDBACK,
    ),
    _arm(
        "arm frozen",
        "The controller does nothing, and its connections stay. What it has received and not read "
        "is driven when it goes on: 0.1 s of the motion.",
        "freeze_all",
        ARM_FEEDBACK,
        leftover=0.1,
    ),
    _arm(
        "arm connections reset",
        "All connections to the controller are reset.",
        "reset_connections",
    ),
    _drive("drive fault", "A drive has an error (EMCY).", "fault"),
    _drive("drive silent", "A drive sends nothing.", "silent", MISSED_REPORTS),
    _drive("drive restarts", "A drive restarts in motion.", "reboot", MISSED_REPORTS),
    _drive(
        "drive deaf", "A drive receives nothing.", "deaf", Timeout(0.1, "can.heartbeat_timeout")
    ),
    _drive(
        "drive reports frozen",
        "A drive's reports stop; its heartbeat goes on.",
        "frozen_reports",
        MISSED_REPORTS,
    ),
    _drive(
        "drive heartbeat lost",
        "A drive's heartbeat stops; its reports go on.",
        "no_heartbeat",
        Timeout(0.09, "can.drive_heartbeat"),
    ),
    _drive(
        "drive reports short",
        "A drive's reports lack their last byte.",
        "short_reports",
        MISSED_REPORTS,
    ),
    _latched(
        "encoder frozen",
        Subject.SENSOR,
        "A drive reports an unchanging position and velocity; the robot speeds up meanwhile, "
        "within its limits.",
        Setting(DRIVES, "can_faults.frozen_encoder", FRONT_LEFT, ()),
        (BRIDGE,),
        Timeout(0.07, "0.2 rad of the wheel, and a report"),
        slowly=0.2,
    ),
    _latched(
        "supply fails",
        Subject.DRIVE,
        "The supply voltage of all drives fails.",
        Setting(DRIVES, "can_faults.supply", 5.0, 0.0),
        (BRIDGE,),
    ),
    *(
        _harmless(
            f"{topic} {content.value}",
            Subject.LINK,
            f"A second publisher of `{topic}` sends invalid messages ({content.value}).",
            Publication(topic, content),
        )
        for topic, content in (
            ("wheel_commands", InvalidContent.NAN),
            ("wheel_commands", InvalidContent.WRONG_NAMES),
            ("wheel_states", InvalidContent.NAN),
            ("wheel_states", InvalidContent.EMPTY),
            ("odom", InvalidContent.NAN),
            ("odom", InvalidContent.WRONG_FRAME),
            ("arm/joint_states", InvalidContent.NAN),
            ("arm/joint_states", InvalidContent.WRONG_NAMES),
            ("arm/joint_reference", InvalidContent.NAN),
            ("arm/joint_reference", InvalidContent.HUGE),
            ("motion_limit", InvalidContent.NAN),
        )
    ),
    _process("monitor", MONITOR, SIGKILL, MOTION_LIMIT, RequiredOutcome.PAUSED),
    _process("monitor", MONITOR, SIGSTOP, MOTION_LIMIT, RequiredOutcome.PAUSED),
    _latched(
        "emergency stop",
        Subject.PERSON,
        "The emergency stop is pressed.",
        EmergencyStop(),
        (CONTROLLER, BRIDGE, STREAMER),
    ),
    _latched(
        "emergency stop contradicted",
        Subject.PERSON,
        "The emergency stop is pressed, and another publisher sends false all the while: no reset "
        "is granted before the first one is released.",
        EmergencyStop(others_release=True),
        (CONTROLLER, BRIDGE, STREAMER),
    ),
    *(
        _latched(
            f"stop of {node}",
            Subject.PERSON,
            f"`~/stop` of `{node}` is called.",
            ServiceStop(node),
            (node,),
        )
        for node in (CONTROLLER, BRIDGE, STREAMER)
    ),
)  #: All rows of the table
