import pytest

from omniman_ros.drive.channel import Channel


def test_what_is_sent_arrives_in_order_and_when_it_is_due():
    channel = Channel()
    for k in range(3):
        channel.put(k, now=0.1 * k, late=0.25)
    assert channel.due(0.2) == []
    assert channel.due(0.3) == [0]
    assert channel.due(1.0) == [1, 2]
    assert channel.due(2.0) == []


def test_without_delay_it_arrives_at_once():
    channel = Channel()
    channel.put("a", now=5.0)
    assert channel.due(5.0) == ["a"]


def test_a_shorter_delay_does_not_overtake():
    channel = Channel()
    channel.put("first", now=0.0, late=0.5)
    channel.put("second", now=0.1)
    assert channel.due(0.2) == []
    assert channel.due(0.5) == ["first", "second"]


@pytest.mark.parametrize("lost", [0.0, 0.3, 1.0])
def test_as_many_are_lost_as_it_says_and_the_same_ones_each_time(lost):
    arrived = []
    for _ in range(2):
        channel = Channel(seed=3)
        for k in range(2000):
            channel.put(k, now=0.0, lost=lost)
        arrived.append(channel.due(0.0))
    assert arrived[0] == arrived[1]
    assert len(arrived[0]) == pytest.approx(2000 * (1 - lost), abs=80 if 0 < lost < 1 else 0)
