"""Service calls: stop and reset of all nodes, pause, resume and cancel of path and planner."""

from typing import Any

from std_srvs.srv import Trigger

from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stoppable_nodes import TriggerCalls, find_stoppable_nodes
from omniman_ros.viewer.view_state import PAUSABLE_NODES, ViewState

ANSWER_TIMEOUT = 4.0  #: Time in which nodes are searched, and answers awaited [s]
ACTIONS = ("pause", "resume", "cancel")  #: Names of the services of these nodes


class ServiceCalls:
    """Calls services of other nodes without blocking; answers are collected each period."""

    def __init__(self, node: OmnimanNode, state: ViewState) -> None:
        self._node = node
        self._state = state
        self._clients = {
            f"{name}/{action}": node.create_client(Trigger, f"{name}/{action}")
            for name in PAUSABLE_NODES
            for action in ACTIONS
        }
        self._search: tuple[str, TriggerCalls, float] | None = None
        self._action = ""
        self._reports = False
        self._futures: dict[str, Any] = {}
        self._answers: dict[str, str] = {}
        self._deadline = 0.0
        self._last_note = ""

    @property
    def answered(self) -> bool:
        """Whether every request to path and planner is answered or has timed out."""
        return not self._futures

    def stop_or_reset(self, action: str, now: float) -> None:
        """Call `stop` or `reset` of all nodes that move something, now or a little later.

        A reset ends the search for nodes to stop, and vice versa.
        """
        self._end_search()
        calls = TriggerCalls(self._node, action, self._node.get_namespace())
        self._search = action, calls, now + ANSWER_TIMEOUT

    def request(
        self,
        action: str,
        now: float,
        *,
        nodes: tuple[str, ...] = PAUSABLE_NODES,
        report: bool = True,
    ) -> None:
        """Ask the nodes that are running to pause, resume or cancel."""
        self._drop_requests()
        self._action, self._reports, self._deadline = action, report, now + ANSWER_TIMEOUT
        for name in nodes:
            client = self._clients[f"{name}/{action}"]
            if client.service_is_ready():
                self._futures[name] = client.call_async(Trigger.Request())
                self._answers[name] = f"{name} ..."
        if report and not self._futures:
            self._note(f"{action}: no {' or '.join(nodes)}")
        else:
            self._report()

    def collect(self, now: float) -> None:
        """Collect answers; for a stop or reset, also call the nodes that were found meanwhile."""
        if self._search is not None:
            self._continue_search(*self._search, now)
        for name, future in list(self._futures.items()):
            if future.done():
                del self._futures[name]
                self._answers[name] = self._describe(name, future.result())
                self._report()
        if self._futures and now > self._deadline:
            for name in self._futures:
                self._answers[name] = _answer_text(name, None)
            self._report()
            self._drop_requests()

    def reset_time(self, now: float) -> None:
        """Restart all deadlines after time went back."""
        self._deadline = now + ANSWER_TIMEOUT
        if self._search is not None:
            action, calls, _ = self._search
            self._search = action, calls, now + ANSWER_TIMEOUT

    def survey(self) -> None:
        """Update which nodes are running and which services are available."""
        self._state.mark_gone(find_stoppable_nodes(self._node, self._node.get_namespace()))
        self._state.services = frozenset(
            name for name, client in self._clients.items() if client.service_is_ready()
        )

    def _continue_search(
        self, action: str, calls: TriggerCalls, deadline: float, now: float
    ) -> None:
        calls.poll()
        answers = [
            _answer_text(name.rpartition("/")[2], answer) for name, answer in calls.answers.items()
        ]
        self._note(f"{action}: {', '.join(answers) or 'no node found yet'}")
        if now > deadline:
            self._end_search()

    def _describe(self, name: str, answer: Trigger.Response) -> str:
        """Describe an answer; a refusal is left out if the action does not apply to the node."""
        if not answer.success and self._state.reports_nothing_to(self._action, name):
            return ""
        return _answer_text(name, (answer.success, answer.message))

    def _report(self) -> None:
        if self._reports:
            answers = ", ".join(text for text in self._answers.values() if text)
            self._note(f"{self._action}: {answers or f'nothing to {self._action}'}")

    def _note(self, text: str) -> None:
        """Note a text once, so that a later note of another action is not overwritten."""
        if text != self._last_note:
            self._last_note = self._state.note = text

    def _drop_requests(self) -> None:
        for name, future in self._futures.items():
            self._clients[f"{name}/{self._action}"].remove_pending_request(future)
        self._futures.clear()
        self._answers = {}
        self._last_note = ""

    def _end_search(self) -> None:
        self._last_note = ""
        if self._search is not None:
            self._search[1].close()
            self._search = None


def _answer_text(name: str, answer: tuple[bool, str] | None) -> str:
    """Put an answer (success, message) into words; None means that there is no answer."""
    if answer is None:
        return f"{name} does not answer"
    success, message = answer
    return f"{name} done" if success else f"{name} REFUSED ({message})"
