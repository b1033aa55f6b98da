import pytest

from omniman_ros.simulation.plant.lossy_channel import LossyChannel


def test_messages_arrive_in_order_after_their_delay():
    channel = LossyChannel()
    for k in range(3):
        channel.put(k, now=0.1 * k, late=0.25)
    assert channel.due(0.2) == []
    assert channel.due(0.3) == [0]
    assert channel.due(1.0) == [1, 2]
    assert channel.due(2.0) == []


def test_message_without_delay_arrives_at_once():
    channel = LossyChannel()
    channel.put("a", now=5.0)
    assert channel.due(5.0) == ["a"]


def test_message_with_a_shorter_delay_does_not_overtake():
    channel = LossyChannel()
    channel.put("first", now=0.0, late=0.5)
    channel.put("second", now=0.1)
    assert channel.due(0.2) == []
    assert channel.due(0.5) == ["first", "second"]


@pytest.mark.parametrize("lost", [0.0, 0.3, 1.0])
def test_configured_fraction_is_lost_and_losses_are_reproducible(lost):
    arrived = []
    for _ in range(2):
        channel = LossyChannel(seed=3)
        for k in range(2000):
            channel.put(k, now=0.0, lost=lost)
        arrived.append(channel.due(0.0))
    assert arrived[0] == arrived[1]
    assert len(arrived[0]) == pytest.approx(2000 * (1 - lost), abs=80 if 0 < lost < 1 else 0)
