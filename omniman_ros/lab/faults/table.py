"""The table of faults: each row names a fault and what must happen then.

`omniman bench faults` plays the rows against the running robot, and the documentation shows them.
"""

from signal import SIGKILL, SIGSTOP

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
    InvalidContent,
    Publication,
    Restart,
    Second,
    ServiceStop,
    Setting,
    Signal,
    TwistFault,
)
from omniman_ros.lab.faults.rows import GoingOn, Motion, Outcome, Row, Subject

FRONT_LEFT = ("front_left",)  # wheel whose drive fails
MISSED_REPORTS = (0.06, "can.missed_periods")
"""Time for which reports of a drive are missing until it counts as lost [s], and what sets it."""
LOST_SOURCE = 0.1
"""Longest permitted time from the evidence that a source is lost until the robot brakes [s]."""


def _twist_row(name: str, fault: str, injection: TwistFault) -> Row:
    """Return the row of a source of twists that is lost."""
    return Row(
        name,
        Subject.SOURCE,
        fault,
        injection,
        Outcome.PAUSED,
        GoingOn.COMMAND,
        unnoticed=0.5,
        timeout="timeouts.cmd_vel",
        reaction=LOST_SOURCE,
        arm=False,
        source="none",
    )


def _harmless(
    name: str,
    subject: Subject,
    fault: str,
    injection: TwistFault | Publication,
    outcome: Outcome = Outcome.UNHARMED,
) -> Row:
    """Return the row of a fault that must not stop the robot."""
    return Row(
        name,
        subject,
        fault,
        injection,
        outcome,
        GoingOn.NOTHING,
        platform=False,
        arm=False,
    )


def _drive_row(
    name: str, fault: str, parameter: str, unnoticed: float = 0.0, timeout: str = ""
) -> Row:
    """Return the row of a drive that fails."""
    return Row(
        name,
        Subject.DRIVE,
        fault,
        Setting(DRIVES, f"can_faults.{parameter}", FRONT_LEFT, ()),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        unnoticed=unnoticed,
        timeout=timeout,
        stopped=(BRIDGE,),
    )


def _arm_row(name: str, fault: str, parameter: str, unnoticed: float = 0.0) -> Row:
    """Return the row of a fault of the arm's controller or of the connection to it."""
    return Row(
        name,
        Subject.ARM,
        fault,
        Setting(ARM, f"faults.{parameter}", True, False),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        unnoticed=unnoticed,
        timeout="ur.feedback_timeout" if unnoticed else "",
        stopped=(STREAMER,),
    )


ROWS = (
    _twist_row("cmd_vel silent", "The publisher of `cmd_vel` falls silent.", TwistFault.SILENT),
    _twist_row("cmd_vel NaN", "`cmd_vel` is NaN from now on.", TwistFault.NAN),
    _twist_row("cmd_vel infinite", "`cmd_vel` is infinite from now on.", TwistFault.INFINITE),
    _harmless(
        "cmd_vel jump",
        Subject.SOURCE,
        "`cmd_vel` is a hundred times too fast: speed and acceleration keep to the limits.",
        TwistFault.JUMP,
        Outcome.LIMITED,
    ),
    _harmless(
        "cmd_vel twice",
        Subject.SOURCE,
        "Two publishers of `cmd_vel` contradict each other: the limits hold.",
        TwistFault.OPPOSED,
        Outcome.LIMITED,
    ),
    _harmless(
        "cmd_vel flood", Subject.SOURCE, "`cmd_vel` comes 1000 times a second.", TwistFault.FLOOD
    ),
    Row(
        "interpolator killed",
        Subject.PROCESS,
        "`path_interpolator` is killed.",
        Signal(INTERPOLATOR, SIGKILL),
        Outcome.ENDED,
        GoingOn.RESTART,
        motion=Motion.TRAJECTORY,
        reaction=LOST_SOURCE,
        unnoticed=0.4,
        timeout="horizon",
        source="none",
    ),
    Row(
        "interpolator suspended",
        Subject.PROCESS,
        "`path_interpolator` is suspended for 1 s, and goes on.",
        Signal(INTERPOLATOR, SIGSTOP, resume=1.0),
        Outcome.ENDED,
        GoingOn.COMMAND,
        motion=Motion.TRAJECTORY,
        reaction=LOST_SOURCE,
        unnoticed=0.4,
        timeout="horizon",
        source="none",
    ),
    Row(
        "controller killed",
        Subject.PROCESS,
        "`platform_controller` is killed.",
        Signal(CONTROLLER, SIGKILL),
        Outcome.ENDED,
        GoingOn.RESTART,
        motion=Motion.TRAJECTORY,
        unnoticed=0.1,
        timeout="odom_pause",
        slowly=1.6,
    ),
    Row(
        "controller suspended",
        Subject.PROCESS,
        "`platform_controller` is suspended, and goes on after the judgement.",
        Signal(CONTROLLER, SIGSTOP),
        Outcome.ENDED,
        GoingOn.COMMAND,
        motion=Motion.TRAJECTORY,
        unnoticed=0.1,
        timeout="odom_pause",
        slowly=1.6,
    ),
    Row(
        "controller restarted",
        Subject.PROCESS,
        "`platform_controller` is killed in motion, and started again at once.",
        Restart(CONTROLLER),
        Outcome.ENDED,
        GoingOn.COMMAND,
        motion=Motion.TRAJECTORY,
        unnoticed=0.1,
        timeout="odom_pause",
        slowly=1.6,
    ),
    Row(
        "bridge killed",
        Subject.PROCESS,
        "`can_bridge` is killed.",
        Signal(BRIDGE, SIGKILL),
        Outcome.LATCHED,
        GoingOn.RESTART,
        motion=Motion.TRAJECTORY,
        unnoticed=0.2,
        timeout="timeouts.wheel_states",
        stopped=(CONTROLLER,),
    ),
    Row(
        "bridge suspended",
        Subject.PROCESS,
        "`can_bridge` is suspended, and goes on after the judgement.",
        Signal(BRIDGE, SIGSTOP),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        unnoticed=0.2,
        timeout="timeouts.wheel_states",
        stopped=(CONTROLLER,),
    ),
    Row(
        "bridge twice",
        Subject.PROCESS,
        "A second `can_bridge` is started on the same bus: it leaves the drives alone.",
        Second(BRIDGE),
        Outcome.UNHARMED,
        GoingOn.NOTHING,
        platform=False,
        arm=False,
    ),
    Row(
        "streamer killed",
        Subject.PROCESS,
        "`arm_streamer` is killed.",
        Signal(STREAMER, SIGKILL),
        Outcome.ENDED,
        GoingOn.RESTART,
        motion=Motion.TRAJECTORY,
        unnoticed=0.2,
        timeout="joint_trajectory.states_timeout",
        slowly=1.5,
    ),
    Row(
        "streaming process killed",
        Subject.PROCESS,
        "The streaming process of `arm_streamer` is killed.",
        Signal(STREAMING_PROCESS, SIGKILL),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        stopped=(STREAMER,),
    ),
    Row(
        "streaming process suspended",
        Subject.PROCESS,
        "The streaming process of `arm_streamer` is suspended, and goes on after the judgement.",
        Signal(STREAMING_PROCESS, SIGSTOP),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        unnoticed=0.5,
        timeout="the streamer waits for its process",
        stopped=(STREAMER,),
    ),
    Row(
        "arm controller killed",
        Subject.ARM,
        "The arm's controller is gone.",
        Signal(ARM, SIGKILL),
        Outcome.LATCHED,
        GoingOn.RESTART,
        motion=Motion.TRAJECTORY,
        stopped=(STREAMER,),
        arm=False,
    ),
    _arm_row(
        "arm protective stop", "The arm's controller makes a protective stop.", "protective_stop"
    ),
    Row(
        "arm emergency stop",
        Subject.ARM,
        "The emergency stop of the arm's pendant is pressed.",
        Setting(ARM, "faults.emergency_stop", True, False, ("power on", "brake release")),
        Outcome.LATCHED,
        GoingOn.PENDANT,
        motion=Motion.TRAJECTORY,
        stopped=(STREAMER,),
    ),
    _arm_row("arm program paused", "The program is paused at the pendant.", "pause_program"),
    _arm_row(
        "arm data frozen", "The controller's data stop; the connections stay.", "freeze_rtde", 0.1
    ),
    Row(
        "arm frozen",
        Subject.ARM,
        "The controller does nothing, and its connections stay. What it has received and not read "
        "is driven when it goes on: 0.1 s of the motion.",
        Setting(ARM, "faults.freeze_all", True, False),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        unnoticed=0.1,
        timeout="ur.feedback_timeout",
        leftover=0.1,
        stopped=(STREAMER,),
    ),
    _arm_row(
        "arm connections reset",
        "All connections to the controller are reset.",
        "reset_connections",
    ),
    _drive_row("drive fault", "A drive has an error (EMCY).", "fault"),
    _drive_row("drive silent", "A drive sends nothing.", "silent", *MISSED_REPORTS),
    _drive_row("drive restarts", "A drive restarts in motion.", "reboot", *MISSED_REPORTS),
    _drive_row("drive deaf", "A drive receives nothing.", "deaf", 0.1, "can.heartbeat_timeout"),
    _drive_row(
        "drive reports frozen",
        "A drive's reports stop; its heartbeat goes on.",
        "frozen_reports",
        *MISSED_REPORTS,
    ),
    _drive_row(
        "drive heartbeat lost",
        "A drive's heartbeat stops; its reports go on.",
        "no_heartbeat",
        0.09,
        "can.drive_heartbeat",
    ),
    _drive_row(
        "drive reports short",
        "A drive's reports lack their last byte.",
        "short_reports",
        *MISSED_REPORTS,
    ),
    Row(
        "encoder frozen",
        Subject.SENSOR,
        "A drive reports an unchanging position and velocity; the robot speeds up meanwhile, "
        "within its limits.",
        Setting(DRIVES, "can_faults.frozen_encoder", FRONT_LEFT, ()),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        unnoticed=0.07,
        timeout="0.2 rad of the wheel, and a report",
        slowly=0.2,
        stopped=(BRIDGE,),
    ),
    Row(
        "supply fails",
        Subject.DRIVE,
        "The supply voltage of all drives fails.",
        Setting(DRIVES, "can_faults.supply", 5.0, 0.0),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        stopped=(BRIDGE,),
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
    Row(
        "monitor killed",
        Subject.PROCESS,
        "`collision_monitor` is killed.",
        Signal(MONITOR, SIGKILL),
        Outcome.PAUSED,
        GoingOn.RESTART,
        unnoticed=0.2,
        timeout="collision_monitor.timeout",
    ),
    Row(
        "monitor suspended",
        Subject.PROCESS,
        "`collision_monitor` is suspended, and goes on after the judgement.",
        Signal(MONITOR, SIGSTOP),
        Outcome.PAUSED,
        GoingOn.NOTHING,
        unnoticed=0.2,
        timeout="collision_monitor.timeout",
    ),
    Row(
        "emergency stop",
        Subject.PERSON,
        "The emergency stop is pressed.",
        EmergencyStop(),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        stopped=(CONTROLLER, BRIDGE, STREAMER),
    ),
    Row(
        "emergency stop contradicted",
        Subject.PERSON,
        "The emergency stop is pressed, and another publisher sends false all the while: no reset "
        "is granted before the first one is released.",
        EmergencyStop(others_release=True),
        Outcome.LATCHED,
        GoingOn.RESET,
        motion=Motion.TRAJECTORY,
        stopped=(CONTROLLER, BRIDGE, STREAMER),
    ),
    *(
        Row(
            f"stop of {node}",
            Subject.PERSON,
            f"`~/stop` of `{node}` is called.",
            ServiceStop(node),
            Outcome.LATCHED,
            GoingOn.RESET,
            motion=Motion.TRAJECTORY,
            stopped=(node,),
        )
        for node in (CONTROLLER, BRIDGE, STREAMER)
    ),
)
"""All rows of the table."""
