"""The program that the controller runs: our own URScript.

Source: Universal Robots, "URScript Programming Language" for CB3: threads, sockets, servoj.

It calls the host, reads a setpoint at a time (see `reverse.py`) and servos to it in each cycle.
In a cycle without a new one it goes on by the last step: setpoints and cycles have two clocks, and
now and then two setpoints come in one cycle and none in the next. It ends, with the arm brought to
rest, when told to, when nothing came for the read time-out, when the connection is closed, and
when a setpoint is further from the one before than the arm moves in a cycle.
"""

from omniman_ros.arm.parameters import PERIOD, UrParameters
from omniman_ros.arm.reverse import JOINTS, SCALE, Mode

STOP_DECELERATION = 4.0
"""Of stopj at the program's end [rad/s^2]."""
STEP = 0.04
"""Largest step between two setpoints that the program takes; pi rad/s makes 0.025 [rad]."""

TEXT = """\
def omniman():
  global setpoint = get_actual_joint_positions()
  global step = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global missed = 0
  global servoing = True
  thread servo():
    while servoing:
      enter_critical
      q = setpoint
      if missed > 0:
        i = 0
        while i < {joints}:
          q[i] = q[i] + missed * step[i]
          i = i + 1
        end
      end
      missed = missed + 1
      exit_critical
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


def program(parameters: UrParameters, host: str, port: int) -> str:
    """Text of the program.

    Args:
        parameters: How it servos, and where it counts.
        host, port: Where it calls.
    """
    return TEXT.format(
        host=host, port=port, register=parameters.register, period=PERIOD,
        lookahead=parameters.lookahead_time, gain=parameters.gain, deceleration=STOP_DECELERATION,
        joints=JOINTS, numbers=JOINTS + 2, servo=int(Mode.SERVO), scale=SCALE, step=STEP,
    )  # fmt: skip
