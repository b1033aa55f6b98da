from types import SimpleNamespace

import pytest

from omniman_ros.client.shared_node import SharedNode


class SteppedNode:
    """A node on simulated time, which whoever waits for something moves on in nanoseconds."""

    def __init__(self, start):
        self.nanoseconds, self.steps = round(start * 1e9), 0

    def get_parameter(self, name):
        return SimpleNamespace(value=name == "use_sim_time")

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.nanoseconds))

    def serve(self, seconds):
        self.nanoseconds += round(seconds * 1e9)
        self.steps += 1
        assert self.steps < 100, f"{seconds} s are waited for again and again"


@pytest.mark.parametrize("start", [0.0, 1000.66, 1.8e9 + 0.1])
def test_a_wait_on_simulated_time_ends_after_its_time_however_it_is_rounded(start):
    for nanoseconds in range(0, 100_000_000, 3_333_333):
        node = SteppedNode(start + nanoseconds * 1e-9)
        begin = node.nanoseconds
        shared = SharedNode(node, "/robot", node.serve)
        assert not shared.wait(lambda: False, 0.2)
        assert (node.nanoseconds - begin) * 1e-9 == pytest.approx(0.2, abs=2e-6)
