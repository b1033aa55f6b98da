"""A program of the kind that drivers upload: one thread reads setpoints, one servos to them."""

DRIVER = """\
def streaming():
  UNIT = 1000000
  NONE = -1
  USED = 0
  FRESH = 1
  step_time = get_steptime()
  global servo_q = get_joint_positions()
  global servo_last = servo_q
  global setpoint = NONE
  global mode = 0
  global wait = 0.0
  servo_thread = 0

  def read_q(m):
    return [m[2] / UNIT, m[3] / UNIT, m[4] / UNIT, m[5] / UNIT, m[6] / UNIT, m[7] / UNIT]
  end

  def accept(q):
    enter_critical
    setpoint = FRESH
    servo_last = servo_q
    servo_q = q
    exit_critical
  end

  thread servo():
    while mode == 1:
      enter_critical
      q = servo_q
      if setpoint == USED:
        q = servo_q + (servo_q - servo_last)
        servo_last = servo_q
        servo_q = q
      end
      state = setpoint
      if setpoint > NONE:
        setpoint = USED
      end
      exit_critical
      if state == NONE:
        sync()
      else:
        servoj(q, t=step_time, lookahead_time=0.03, gain=1000)
      end
    end
    stopj(4.0)
  end

  attempt = 0
  while not socket_open("10.0.0.2", 50001, "reverse") and attempt < 3:
    sleep(0.2)
    attempt = attempt + 1
  end
  textmsg("active")
  while mode > -2:
    message = socket_read_binary_integer(8, "reverse", wait)
    if message[0] > 0:
      wait = message[1] / 1000.0
      if mode != message[8]:
        mode = message[8]
        join servo_thread
        if mode == 1:
          servo_q = get_joint_positions()
          servo_thread = run servo()
        end
      end
      if mode == 1:
        accept(read_q(message))
      end
    else:
      textmsg("timed out")
      mode = -2
      kill servo_thread
      stopj(4.0)
      halt
    end
  end
  join servo_thread
  socket_close("reverse")
end
"""
