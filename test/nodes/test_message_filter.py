"""Messages that wait for the transforms of their frames."""

from std_msgs.msg import Header

from omniman_ros.nodes.frame_transforms import MOST_WAITING, MessageFilter

WAIT = 0.3


class Topic:
    """Messages, each a list of frames, and a filter of them."""

    def __init__(self) -> None:
        self.missing = {"map"}
        self.now: list[list[str]] = []
        self.later: list[list[str]] = []
        self.given_up: list[str] = []
        self.filter = MessageFilter(
            lambda frames: (Header(frame_id=frame) for frame in frames),
            lambda header: header.frame_id in self.missing,
            lambda headers: self.given_up.extend(header.frame_id for header in headers),
            self.handle,
            self.later.append,
        )

    def handle(self, frames: list[str]) -> str:
        self.now.append(frames)
        return "handled"


def test_a_message_whose_transforms_are_known_is_handled_at_once_with_its_result():
    topic = Topic()
    assert topic.filter.handle(["odom"], 0.0) == "handled"
    assert topic.now == [["odom"]] and topic.later == []


def test_a_message_waits_while_one_of_its_transforms_is_missing():
    topic = Topic()
    assert topic.filter.handle(["odom", "map"], 0.0) is None
    topic.filter.retry(0.9 * WAIT, WAIT)
    assert topic.now == topic.later == []
    topic.missing.clear()
    topic.filter.retry(0.9 * WAIT, WAIT)
    assert topic.later == [["odom", "map"]] and topic.given_up == []


def test_messages_keep_their_order_behind_one_that_waits():
    topic = Topic()
    topic.filter.handle(["map"], 0.0)
    topic.filter.handle(["odom"], 0.1)
    assert topic.now == []
    topic.missing.clear()
    topic.filter.retry(0.1, WAIT)
    assert topic.later == [["map"], ["odom"]]


def test_after_the_wait_a_message_is_handed_on_and_its_frames_are_given_up():
    topic = Topic()
    topic.filter.handle(["map", "odom"], 0.0)
    topic.filter.handle(["map"], 0.1)
    topic.filter.retry(WAIT, WAIT)
    assert topic.later == [["map", "odom"]] and topic.given_up == ["map", "odom"]
    topic.filter.retry(0.1 + WAIT, WAIT)
    assert topic.later[1:] == [["map"]]


def test_a_message_from_the_future_waits_no_more():
    topic = Topic()
    topic.filter.handle(["map"], 5.0)
    topic.filter.retry(4.0, WAIT)  # the clock went back
    assert topic.later == [["map"]]


def test_the_oldest_of_too_many_messages_wait_no_more_and_none_is_lost():
    topic = Topic()
    for i in range(MOST_WAITING + 3):
        topic.filter.handle(["map", str(i)], 0.0)
    assert [frames[1] for frames in topic.later] == ["0", "1", "2"]
    topic.missing.clear()
    topic.filter.retry(0.0, WAIT)
    assert [frames[1] for frames in topic.later] == [str(i) for i in range(MOST_WAITING + 3)]
