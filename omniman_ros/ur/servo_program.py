"""URScript program that the controller runs to servo along the setpoints of this host.

Source: Universal Robots, "URScript Programming Language" for CB3: threads, sockets, servoj.

The program connects to the host, reads one setpoint at a time (see `reverse_interface`), and
servos to it in each cycle. In a cycle without a new setpoint it continues by the last step:
setpoints and cycles run on two clocks, so occasionally two setpoints arrive in one cycle and none
in the next. The setpoint after a gap is elsewhere, and a stiff servo would jump to it. So a joint
catches up within its limits of speed and acceleration: at a distance d it is faster than its
setpoints by the speed from which a constant deceleration stops it in d. Setpoints that come in
time keep the limits, and are passed on as they are.

The program brings the arm to rest and ends when a message asks for it, when nothing arrives for
the read timeout, when the connection is closed, and when a setpoint is further from the last one
than the arm can move in a cycle.
"""

from omniman_ros.core.arrays import Array
from omniman_ros.ur.joint_guard import JointLimits
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.reverse_interface import JOINTS, SCALE, ProgramMode

STOP_DECELERATION = 4.0  #: Deceleration of stopj at the end of the program [rad/s^2]
#: Largest step between two setpoints that the program accepts [rad]; pi rad/s gives 0.025 rad
MAX_STEP = 0.04
#: Fraction of the acceleration limits that a joint uses to catch up: the servo overshoots what is
#: asked of it by up to 5 % where that changes suddenly
CATCHING_UP_FRACTION = 0.95
#: Fraction of the acceleration limits by which a joint that catches up brakes towards its
#: setpoints, which may need the rest themselves
BRAKING_FRACTION = 0.4

TEMPLATE = """\
def omniman():
  global setpoint = get_actual_joint_positions()
  global step = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global missed = 0
  global servoing = True
  thread servo():
    fastest = {fastest}
    hardest = {hardest}
    catching_up = {catching_up}
    braking = {braking}
    q = setpoint
    moved = step
    while servoing:
      enter_critical
      goal = setpoint
      rate = step
      late = missed
      missed = missed + 1
      exit_critical
      j = 0
      while j < {joints}:
        behind = goal[j] + (late - 1) * rate[j] - q[j]
        speed = rate[j] + behind
        if norm(speed - moved[j]) > hardest[j]:
          if behind > braking[j]:
            behind = sqrt(braking[j] * (2 * behind + braking[j] / 4)) - braking[j] / 2
          elif behind < -braking[j]:
            behind = braking[j] / 2 - sqrt(braking[j] * (braking[j] / 4 - 2 * behind))
          end
          speed = rate[j] + behind
          if speed > moved[j] + catching_up[j]:
            speed = moved[j] + catching_up[j]
          elif speed < moved[j] - catching_up[j]:
            speed = moved[j] - catching_up[j]
          end
        end
        if speed > fastest[j]:
          speed = fastest[j]
        elif speed < -fastest[j]:
          speed = -fastest[j]
        end
        moved[j] = speed
        q[j] = q[j] + speed
        j = j + 1
      end
      servoj(q, t={period}, lookahead_time={lookahead}, gain={gain})
    end
    stopj({deceleration})
    return False
  end

  if not socket_open("{host}", {port}, "omniman"):
    textmsg("omniman: no connection to {host}")
    halt
  end
  read = 0
  write_output_integer_register({register}, 0)
  data = socket_read_binary_integer({numbers}, "omniman", 0)
  going = data[0] == {numbers}
  while going:
    if data[{numbers}] != {servo}:
      going = False
    else:
      next = setpoint
      change = setpoint
      i = 0
      while i < {joints}:
        next[i] = data[i + 2] / {scale}
        change[i] = next[i] - setpoint[i]
        if change[i] > {step} or change[i] < -{step}:
          going = False
        end
        i = i + 1
      end
      if not going:
        textmsg("omniman: a setpoint jumps")
      else:
        enter_critical
        setpoint = next
        if read > 0:
          step = change
        end
        missed = 0
        exit_critical
        if read == 0:
          servo_thread = run servo()
        end
        read = read + 1
        write_output_integer_register({register}, read)
        data = socket_read_binary_integer({numbers}, "omniman", data[1] / 1000.0)
        going = data[0] == {numbers}
      end
    end
  end
  if read > 0:
    servoing = False
    join servo_thread
  end
  socket_close("omniman")
end
"""


def servo_program(parameters: UrParameters, limits: JointLimits, host: str, port: int) -> str:
    """Return the program's text, which connects to a host's address and TCP port.

    Args:
        limits: Limits of speed and acceleration of the setpoints, also when a joint catches up.
    """
    change = PERIOD**2 * limits.acceleration
    return TEMPLATE.format(
        host=host,
        port=port,
        register=parameters.register,
        period=PERIOD,
        lookahead=parameters.lookahead_time,
        gain=parameters.gain,
        deceleration=STOP_DECELERATION,
        joints=JOINTS,
        numbers=JOINTS + 2,
        servo=int(ProgramMode.SERVO),
        scale=SCALE,
        step=MAX_STEP,
        fastest=_list(PERIOD * limits.velocity),
        hardest=_list(change),
        catching_up=_list(CATCHING_UP_FRACTION * change),
        braking=_list(BRAKING_FRACTION * change),
    )


def _list(values: Array) -> str:
    return f"[{', '.join(f'{value:.9f}' for value in values)}]"
