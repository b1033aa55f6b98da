import itertools

import pytest

from omniman_ros.core.stop import ResetRefusedError, StopLatch, StopState, StopStatus

RUNNING, HOLDING, STOPPED = StopState.RUNNING, StopState.HOLDING, StopState.STOPPED


def apply(latch, event):
    """Apply an event by name; a refused reset returns its reason."""
    what, _, argument = event.partition(" ")
    try:
        {
            "stop": lambda: latch.stop(argument),
            "emergency": lambda: latch.set_emergency(argument == "true"),
            "peer_stops": lambda: latch.set_peer(argument, True, "why"),
            "peer_runs": lambda: latch.set_peer(argument, False),
            "peer_ends": lambda: latch.set_peer(argument, True, "SIGINT", is_ending=True),
            "peer_vanishes": lambda: latch.lose_peer(argument),
            "reset": lambda: latch.reset(
                at_rest=argument != "moving", fault="bus off" if argument == "fault" else ""
            ),
        }[what]()
    except ResetRefusedError as refusal:
        return str(refusal)
    return ""


TABLE = {
    "it starts released": [("peer_runs x", RUNNING, "")],
    "a stop is latched": [
        ("stop button", STOPPED, "button"),
        ("peer_runs x", STOPPED, "button"),
        ("reset", RUNNING, ""),
    ],
    "the first cause is kept": [
        ("stop button", STOPPED, "button"),
        ("stop bus off", STOPPED, "button"),
    ],
    "emergency false releases nothing": [
        ("emergency true", STOPPED, "emergency_stop"),
        ("emergency false", STOPPED, "emergency_stop"),
        ("reset", RUNNING, ""),
    ],
    "emergency false stops nothing": [("emergency false", RUNNING, "")],
    "reset is refused while emergency is true": [
        ("emergency true", STOPPED, "emergency_stop"),
        ("reset", STOPPED, "emergency_stop"),
        ("emergency false", STOPPED, "emergency_stop"),
        ("reset", RUNNING, ""),
    ],
    "reset is refused while it moves": [
        ("stop button", STOPPED, "button"),
        ("reset moving", STOPPED, "button"),
        ("reset", RUNNING, ""),
    ],
    "reset is refused while the fault is there": [
        ("stop bus off", STOPPED, "bus off"),
        ("reset fault", STOPPED, "bus off"),
        ("reset", RUNNING, ""),
    ],
    "a peer holds and releases": [
        ("peer_stops arm", HOLDING, "stopped peer arm: why"),
        ("peer_runs arm", RUNNING, ""),
    ],
    "two peers both have to run again": [
        ("peer_stops arm", HOLDING, "arm"),
        ("peer_stops base", HOLDING, "base"),
        ("peer_runs arm", HOLDING, "base"),
        ("peer_runs base", RUNNING, ""),
    ],
    "a reset does not release a peer's hold": [
        ("peer_stops arm", HOLDING, "arm"),
        ("stop button", STOPPED, "button"),
        ("reset", HOLDING, "arm"),
        ("peer_runs arm", RUNNING, ""),
    ],
    "a peer that runs again does not clear a stop": [
        ("peer_stops arm", HOLDING, "arm"),
        ("stop button", STOPPED, "button"),
        ("peer_runs arm", STOPPED, "button"),
        ("reset", RUNNING, ""),
    ],
    "a stopped peer that vanishes leaves a stop to reset": [
        ("peer_stops arm", HOLDING, "arm"),
        ("peer_vanishes arm", STOPPED, "peer arm vanished while it was stopped"),
        ("reset", RUNNING, ""),
    ],
    "a peer that ends in order holds until it has vanished": [
        ("peer_ends arm", HOLDING, "arm: SIGINT"),
        ("peer_vanishes arm", RUNNING, ""),
    ],
    "a peer that was started again and stopped is not one that ends": [
        ("peer_ends arm", HOLDING, "arm: SIGINT"),
        ("peer_stops arm", HOLDING, "arm: why"),
        ("peer_vanishes arm", STOPPED, "vanished"),
    ],
    "a stop under a true emergency keeps its cause": [
        ("stop button", STOPPED, "button"),
        ("emergency true", STOPPED, "button"),
        ("reset", STOPPED, "button"),
        ("emergency false", STOPPED, "button"),
        ("reset", RUNNING, ""),
    ],
}


@pytest.mark.parametrize("rule", TABLE)
def test_events_lead_to_the_expected_states(rule):
    latch = StopLatch()
    assert latch.released
    for event, state, reason in TABLE[rule]:
        apply(latch, event)
        assert latch.status.state is state, event
        assert reason in latch.status.reason, event
        assert latch.released is (state is RUNNING)


@pytest.mark.parametrize(
    ("events", "why"),
    [
        (["emergency true", "reset"], "emergency_stop is true"),
        (["stop x", "reset fault"], "the fault is still present: bus off"),
        (["stop x", "reset moving"], "still moving"),
    ],
)
def test_refused_reset_returns_the_reason(events, why):
    latch = StopLatch()
    assert why in [apply(latch, event) for event in events][-1]


def test_new_latches_are_distinguished_from_old_ones():
    latch = StopLatch()
    assert latch.stop("a") is True
    assert latch.stop("b") is False
    assert latch.set_emergency(True) is False
    assert latch.emergency
    assert latch.set_emergency(False) is False
    latch.reset(at_rest=True)
    assert latch.set_emergency(True) is True
    assert latch.set_emergency(True) is False


def test_only_a_node_that_nothing_else_has_stopped_says_that_it_ends():
    latch = StopLatch()
    latch.shut_down("SIGINT")
    assert latch.status == StopStatus(STOPPED, "shutting down: SIGINT", is_ending=True)
    latch.reset(at_rest=True)
    latch.stop("bus off")
    latch.shut_down("SIGINT")
    assert latch.status == StopStatus(STOPPED, "bus off", is_ending=False)


def test_stopped_peers_are_listed():
    latch = StopLatch()
    latch.set_peer("arm", True)
    latch.set_peer("path", True)
    latch.set_peer("path", True)
    assert sorted(latch.peers) == ["arm", "path"]
    latch.set_peer("never seen", False)
    latch.set_peer("arm", False)
    assert latch.peers == ("path",)


EVENTS = ("stop0", "stop1", "stop2", "reset0", "reset1", "reset2", "deliver")


@pytest.mark.parametrize("count", [2, 3])
def test_nodes_that_stop_each_other_are_released_by_one_reset_each(count):
    """No history of stops and resets, in any order of delivery, leaves a deadlock."""
    for history in itertools.product(
        EVENTS[:count] + EVENTS[3 : 3 + count] + EVENTS[6:], repeat=4
    ):
        latches = [StopLatch() for _ in range(count)]

        def deliver(nodes=latches):
            for i, j in itertools.permutations(range(len(nodes)), 2):
                status = nodes[i].status
                nodes[j].set_peer(str(i), status.state is STOPPED, status.reason)

        for event in history:
            if event == "deliver":
                deliver()
            elif event.startswith("stop"):
                latches[int(event[-1])].stop("button")
            else:
                latches[int(event[-1])].reset(at_rest=True)
        for latch in latches:
            latch.reset(at_rest=True)
            deliver()
        assert all(latch.released for latch in latches), history
