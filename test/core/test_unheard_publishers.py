import pytest

from omniman_ros.core.unheard_publishers import LATE_ORDER, SHORT_VISIT, UnheardPublishers

LATER = 1.5 * LATE_ORDER


class Publishers:
    """Publishers that come, are heard and go."""

    def __init__(self):
        self.core, self.present, self.now = UnheardPublishers(), 0, 100.0

    def come(self, after=0.01):
        self.now, self.present = self.now + after, self.present + 1
        self.core.appear(self.now)

    def speak(self, after=0.01):
        self.now += after
        self.core.hear(self.now)

    def go(self, after=0.01):
        self.now, self.present = self.now + after, self.present - 1
        self.core.vanish(self.now, self.present)

    def missed(self, after=LATER):
        self.now += after
        return self.core.missed(self.now)


@pytest.fixture
def publishers():
    return Publishers()


def test_a_short_visit_without_a_message_is_told_once(publishers):
    publishers.come()
    publishers.go()
    assert not publishers.missed(0.5 * LATE_ORDER)
    assert publishers.missed()
    assert not publishers.missed()


@pytest.mark.parametrize("order", ["come speak go", "speak come go", "come go speak"])
def test_a_publisher_that_is_heard_is_not_missed_in_whatever_order_the_news_comes(
    publishers, order
):
    for news in order.split():
        getattr(publishers, news)()
    assert not publishers.missed()
    publishers.come()
    publishers.go()
    assert publishers.missed()


def test_one_that_was_there_for_long_and_silent_may_go(publishers):
    publishers.come()
    publishers.go(SHORT_VISIT + 0.1)
    assert not publishers.missed()


def test_one_that_speaks_all_the_time_does_not_hide_another_that_is_not_heard(publishers):
    publishers.come()
    publishers.speak()
    publishers.come(60.0)
    publishers.go()
    assert publishers.missed()


def test_one_that_is_silent_for_long_is_not_taken_for_another_that_was_heard(publishers):
    publishers.come()
    publishers.come(60.0)
    publishers.speak()
    publishers.go()
    assert not publishers.missed()
    publishers.go(60.0)
    assert not publishers.missed()


def test_a_message_long_ago_does_not_hide_a_visit(publishers):
    publishers.speak()
    publishers.come(LATER)
    publishers.go()
    assert publishers.missed()
