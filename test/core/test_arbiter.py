import pytest
from hypothesis import given
from hypothesis import strategies as st

from omniman_ros.core.arbiter import Arbiter, Source

C, M, P = Source.CMD_VEL, Source.MPC, Source.PATH
SILENCE = {C: 0.5, M: 0.2, P: 0.2}
NAMES = {"cmd_vel": C, "mpc": M, "path": P}


def play(script):
    """Run lines of (time, event, argument) and return the driving source after each.

    event: a source's name, its setpoint fresh for `argument` s; "zero": a neutral cmd_vel;
    "refuse", "ignore" or "cancel": the named source; "stop": cancel all; "-": nothing.
    """
    arbiter, drivers = Arbiter(SILENCE), []
    for now, what, *rest in script:
        if what in NAMES:
            arbiter.offer(NAMES[what], now, now + rest[0])
        elif what == "zero":
            arbiter.offer(C, now, now + 0.5, neutral=True)
        elif what == "refuse":
            arbiter.refuse(NAMES[rest[0]], now, "no")
        elif what == "ignore":
            arbiter.ignore(NAMES[rest[0]], now, "no")
        elif what == "cancel":
            arbiter.cancel(NAMES[rest[0]], "no")
        elif what == "stop":
            arbiter.cancel_all("stop")
        active = arbiter.select(now)
        drivers.append(active.value if active else "none")
    return drivers


SCRIPTS = {
    "nobody drives at first": [((0, "-"), "none")],
    "each alone drives": [
        ((0, "path", 0.1), "path"),
        ((1, "mpc", 0.1), "mpc"),
        ((2, "cmd_vel", 0.1), "cmd_vel"),
    ],
    "the order is cmd_vel, mpc, path": [
        ((0, "path", 5), "path"),
        ((1, "mpc", 5), "mpc"),
        ((2, "cmd_vel", 5), "cmd_vel"),
    ],
    "a lower source takes nothing from a higher one": [
        ((0, "cmd_vel", 5), "cmd_vel"),
        ((1, "mpc", 5), "cmd_vel"),
        ((2, "path", 5), "cmd_vel"),
    ],
    "a source that lost control does not come back by itself": [
        ((0, "path", 9), "path"),
        ((1, "cmd_vel", 0.5), "cmd_vel"),
        ((1.5, "-"), "cmd_vel"),
        ((1.6, "-"), "none"),
        ((5, "-"), "none"),
    ],
    "nor by streaming on": [
        ((0, "path", 9), "path"),
        ((1, "cmd_vel", 0.1), "cmd_vel"),
        *[((1.2 + 0.1 * i, "path", 9), "none") for i in range(30)],
    ],
    "one that was outbid before it ever drove does not start later by itself": [
        ((0, "cmd_vel", 0.5), "cmd_vel"),
        ((0.1, "path", 9), "cmd_vel"),
        ((0.7, "-"), "none"),
    ],
    "silent for long enough, it is heard again": [
        ((0, "path", 9), "path"),
        ((1, "cmd_vel", 0.1), "cmd_vel"),
        ((1.15, "path", 9), "none"),
        ((1.34, "path", 9), "none"),
        ((1.55, "path", 9), "path"),
    ],
    "a stale source is not latched": [
        ((0, "cmd_vel", 0.5), "cmd_vel"),
        ((0.5, "-"), "cmd_vel"),
        ((0.51, "-"), "none"),
        ((0.52, "cmd_vel", 0.5), "cmd_vel"),
    ],
    "after a stop a stream is not heard": [
        ((0, "cmd_vel", 0.5), "cmd_vel"),
        ((0.1, "stop"), "none"),
        *[((0.2 + 0.1 * i, "cmd_vel", 0.5), "none") for i in range(30)],
    ],
    "after a stop a pause makes it heard": [
        ((0, "cmd_vel", 0.5), "cmd_vel"),
        ((0.1, "stop"), "none"),
        ((0.2, "cmd_vel", 0.5), "none"),
        ((0.71, "cmd_vel", 0.5), "cmd_vel"),
    ],
    "after a stop a neutral setpoint makes it heard": [
        ((0, "cmd_vel", 0.5), "cmd_vel"),
        ((0.1, "stop"), "none"),
        ((0.2, "zero"), "cmd_vel"),
        ((0.3, "cmd_vel", 0.5), "cmd_vel"),
    ],
    "a refused setpoint cancels its source": [
        ((0, "path", 9), "path"),
        ((0.1, "refuse", "path"), "none"),
        ((0.2, "path", 9), "none"),
        ((0.5, "path", 9), "path"),
    ],
    "a refused setpoint keeps the source from being silent": [
        ((0, "stop"), "none"),
        *[((0.1 * i, "refuse", "path"), "none") for i in range(1, 20)],
        ((2.0, "path", 9), "none"),
    ],
    "an ignored setpoint cancels nothing, and is not fresh": [
        ((0, "cmd_vel", 0.5), "cmd_vel"),
        ((0.4, "ignore", "cmd_vel"), "cmd_vel"),
        ((0.6, "-"), "none"),
        ((0.7, "cmd_vel", 0.5), "cmd_vel"),
    ],
    "an ignored setpoint keeps a cancelled source from being silent": [
        ((0, "stop"), "none"),
        *[((0.1 * i, "ignore", "path"), "none") for i in range(1, 20)],
        ((2.0, "path", 9), "none"),
    ],
    "a cancelled driver hands over to nobody": [
        ((0, "path", 9), "path"),
        ((1, "mpc", 9), "mpc"),
        ((2, "cancel", "mpc"), "none"),
    ],
}


@pytest.mark.parametrize("rule", SCRIPTS)
def test_driving_source_follows_the_arbitration_rules(rule):
    script = [line for line, _ in SCRIPTS[rule]]
    assert play(script) == [driver for _, driver in SCRIPTS[rule]]


@pytest.mark.parametrize(("first", "second"), [(C, P), (P, C), (C, M), (M, P), (P, M)])
def test_losing_setpoint_of_the_same_tick_does_not_drive_later(first, second):
    arbiter = Arbiter(SILENCE)
    arbiter.offer(first, 0.0, 0.5 if first is C else 9.0)
    arbiter.offer(second, 0.0, 0.5 if second is C else 9.0)
    winner = arbiter.select(0.0)
    assert winner is min((first, second), key=list(Source).index)
    arbiter.cancel(winner, "gone")
    assert arbiter.select(0.6) is None
    assert arbiter.select(5.0) is None


def test_ignored_setpoint_returns_why_its_source_is_cancelled_if_it_is():
    arbiter = Arbiter(SILENCE)
    assert arbiter.ignore(P, 0.0, "too old") == "too old"
    arbiter.cancel(P, "gone")
    assert arbiter.ignore(P, 0.1, "too old") == "gone"


def test_refused_setpoints_return_the_reason():
    arbiter = Arbiter(SILENCE)
    assert arbiter.offer(P, 0.0, 9.0) == ""
    arbiter.select(0.0)
    arbiter.offer(C, 0.1, 0.6)
    arbiter.select(0.1)
    assert arbiter.offer(P, 0.2, 9.0) in ("cmd_vel took over", "cmd_vel drives")
    arbiter.cancel_all("stop: button")
    assert arbiter.offer(C, 0.3, 0.8) == "stop: button"
    assert arbiter.refuse(M, 0.3, "why") == "why"


def test_new_silence_time_applies_from_then_on():
    arbiter = Arbiter(SILENCE)
    arbiter.cancel_all("stop")
    arbiter.offer(C, 0.0, 0.5)
    arbiter.cancel_all("stop")
    arbiter.silence = {C: 5.0, M: 5.0, P: 5.0}
    assert arbiter.offer(C, 1.0, 1.5) == "stop"
    assert arbiter.offer(C, 6.1, 6.6) == ""


EVENTS = st.lists(
    st.tuples(
        st.floats(0, 0.4),
        st.sampled_from(["cmd_vel", "mpc", "path", "stop", "-"]),
        st.floats(0.01, 2.0),
    ),
    max_size=60,
)


@given(EVENTS)
def test_source_starts_to_drive_only_with_a_current_setpoint(events):
    """No source ever takes over with an old setpoint, whatever happened before."""
    arbiter, now, active = Arbiter(SILENCE), 0.0, None
    for pause, what, fresh in events:
        now += pause
        offered = NAMES.get(what)
        if offered is not None:
            arbiter.offer(offered, now, now + fresh)
        elif what == "stop":
            arbiter.cancel_all("stop")
        chosen = arbiter.select(now)
        if chosen is not active and chosen is not None:
            assert chosen is offered
        active = chosen
