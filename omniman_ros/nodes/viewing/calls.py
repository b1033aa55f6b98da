"""Stops and resets of all that moves; pause, resume and cancel of path and planner."""

from typing import Any

from std_srvs.srv import Trigger

from omniman_ros.nodes.movers import Calls, nodes_that_move
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.viewer.state import Picture

CALLING = 4.0
"""How long nodes are looked for that a stop or a reset is meant for, and an answer waited for
[s]."""
ASKED = ("path_interpolator", "mpc_planner")
"""Nodes that hold, go on and cancel."""
ACTIONS = ("pause", "resume", "cancel")
NOTHING = ("nothing to", "no path to", "no trajectory to")
"""A refusal that begins so needs no telling, where another node did what was asked for."""


class CallPort:
    """Services of other nodes; answers are looked for once a period, nothing waits.

    Args:
        node: Who calls.
        picture: Its note says what came of a call.
    """

    def __init__(self, node: OmnimanNode, picture: Picture) -> None:
        self._node = node
        self._picture = picture
        self._clients = {
            f"{name}/{action}": node.create_client(Trigger, f"{name}/{action}")
            for name in ASKED
            for action in ACTIONS
        }
        self._movers: tuple[str, Calls, float] | None = None
        self._asked = ""
        self._tells = False
        self._futures: dict[str, Any] = {}
        self._answers: dict[str, str] = {}
        self._until = 0.0
        self._said = ""

    @property
    def answered(self) -> bool:
        """Whether all that was asked of path and planner is answered, or no longer waited for."""
        return not self._futures

    def reach(self, action: str, now: float) -> None:
        """Stop or reset all nodes that move something, also those found a little later."""
        # A reset ends the search for nodes to stop, and the other way round.
        self._end_search()
        self._movers = action, Calls(self._node, action, self._node.get_namespace()), now + CALLING

    def ask(
        self, action: str, now: float, *, of: tuple[str, ...] = ASKED, tell: bool = True
    ) -> None:
        """Ask the nodes that are there to pause, resume or cancel.

        Args:
            action: See `ACTIONS`.
            now: Time [s].
            of: Which nodes.
            tell: Whether the note tells what they answered.
        """
        self._drop()
        self._asked, self._tells, self._until = action, tell, now + CALLING
        for name in of:
            client = self._clients[f"{name}/{action}"]
            if client.service_is_ready():
                self._futures[name] = client.call_async(Trigger.Request())
                self._answers[name] = f"{name} ..."
        if tell and not self._futures:
            self._say(f"{action}: no {' and no '.join(of)}")
        elif tell:
            self._tell()

    def collect(self, now: float) -> None:
        """Take in answers; a stop also calls nodes that turn up a little later."""
        if self._movers is not None:
            action, calls, until = self._movers
            calls.look()
            answers = [
                _answer(name.rpartition("/")[2], answer) for name, answer in calls.answers.items()
            ]
            self._say(f"{action}: {', '.join(answers) or 'no node found yet'}")
            if now > until:
                self._end_search()
        for name, future in list(self._futures.items()):
            if future.done():
                del self._futures[name]
                answer = future.result()
                idle = not answer.success and answer.message.startswith(NOTHING)
                told = (answer.success, answer.message)
                self._answers[name] = "" if idle else _answer(name, told)
                self._tell()
        if self._futures and now > self._until:
            for name in self._futures:
                self._answers[name] = _answer(name, None)
            self._tell()
            self._drop()

    def start_over(self, now: float) -> None:
        """Time went back: what is waited for is waited for as long as if it began now."""
        self._until = now + CALLING
        if self._movers is not None:
            self._movers = *self._movers[:2], now + CALLING

    def survey(self) -> None:
        """Look who is there."""
        self._picture.keep_stops(nodes_that_move(self._node, self._node.get_namespace()))
        self._picture.services = frozenset(
            name for name, client in self._clients.items() if client.service_is_ready()
        )

    def _tell(self) -> None:
        if self._tells:
            told = ", ".join(text for text in self._answers.values() if text)
            self._say(f"{self._asked}: {told or f'nothing to {self._asked}'}")

    def _say(self, text: str) -> None:
        """Say something once: what others say meanwhile stands."""
        if text != self._said:
            self._said = self._picture.note = text

    def _drop(self) -> None:
        """Wait for no answer any more."""
        for name, future in self._futures.items():
            self._clients[f"{name}/{self._asked}"].remove_pending_request(future)
        self._futures.clear()
        self._answers = {}
        self._said = ""

    def _end_search(self) -> None:
        self._said = ""
        if self._movers is not None:
            self._movers[1].close()
            self._movers = None


def _answer(name: str, answer: tuple[bool, str] | None) -> str:
    """What a service said, in words; None while it has not."""
    if answer is None:
        return f"{name} does not answer"
    success, message = answer
    return f"{name} done" if success else f"{name} REFUSED ({message})"
