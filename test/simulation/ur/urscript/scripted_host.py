"""A controller that records what a program asks for, on a time of its own."""

from omniman_ros.simulation.ur.urscript.compiler import Program
from omniman_ros.simulation.ur.urscript.machine import Machine

STEP = 0.008  # s


class ScriptedHost:
    """Motions last `cycles` of their kind, else until the next cycle; sockets are byte strings."""

    def __init__(self):
        self.ticks = 0
        self.cycles = {}
        self.motions = []
        self.steady = True
        self.log = []
        self.popups = []
        self.inputs = {}
        self.outputs = {}
        self.refused = False
        self.received = {}
        self.sent = {}
        self.calls = []

    @property
    def time(self):
        return self.ticks * STEP

    def motion(self, kind, *arguments):
        self.motions.append((kind, *arguments))
        end = self.ticks + self.cycles.get(kind, 1)
        return lambda: self.ticks >= end

    def servoj(self, q, t, lookahead_time, gain):
        return self.motion("servoj", q, t, lookahead_time, gain)

    def speedj(self, qd, a, t):
        return self.motion("speedj", qd, a, t)

    def stopj(self, a):
        return self.motion("stopj", a)

    def movej(self, q, a, v, t, r):
        return self.motion("movej", q, a, v, t, r)

    def joints(self, what):
        kinds = ("actual_q", "target_q", "actual_qd", "target_qd")
        return (float(kinds.index(what)),) * 6

    def is_steady(self):
        return self.steady

    def speed_scaling(self):
        return 1.0

    def read_register(self, kind, index):
        return self.inputs.get((kind, index), 0)

    def write_register(self, kind, index, value):
        self.outputs[kind, index] = value

    def socket_open(self, host, port, name):
        self.calls.append(("open", host, port, name))
        if self.refused:
            return False
        self.received[name] = b""
        self.sent[name] = b""
        return True

    def socket_close(self, name):
        self.calls.append(("close", name))
        self.received.pop(name, None)

    def socket_take(self, name, count):
        if name not in self.received:
            return None
        data = self.received[name]
        if len(data) < count:
            return b""
        self.received[name] = data[count:]
        return data[:count]

    def socket_send(self, name, data):
        if name not in self.received:
            return False
        self.sent[name] += data
        return True

    def textmsg(self, text):
        self.log.append(text)

    def popup(self, text):
        self.popups.append(text)


class Bench:
    """A program on a scripted host."""

    def __init__(self, text, **options):
        self.host = ScriptedHost()
        self.machine = Machine(Program(text), self.host, **options)

    def step(self, count=1):
        for _ in range(count):
            self.machine.step()
            self.host.ticks += 1
        return self

    @property
    def log(self):
        """What was logged since the last look."""
        lines, self.host.log = self.host.log, []
        return lines

    @property
    def motions(self):
        """Motion commands since the last look."""
        found, self.host.motions = self.host.motions, []
        return found

    @property
    def end(self):
        return self.machine.end_reason


def ran(text, steps=1):
    """A program that has run to its end, or for so many cycles."""
    return Bench(text).step(steps)


def value_of(expression, before=""):
    """Value of an expression."""
    bench = ran(f"{before}\nresult = {expression}\n")
    assert bench.end == "completed", bench.end
    return bench.machine.variables["result"]


def fault_of(text):
    """Line and message of the runtime error that ends a program."""
    end = ran(text).end
    start, _, message = end.partition(": ")
    assert start.startswith("runtime error line "), end
    return int(start.rpartition(" ")[2]), message
