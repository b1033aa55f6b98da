import pytest

from omniman_ros.planning.whole_body.progress_watch import BLOCKED, ProgressWatch


def note(watch, now, place=0.0, is_held=False, is_excused=False):
    watch.note(now, place, is_held=is_held, is_excused=is_excused)


def searches(watch, times, **conditions):
    """Note a robot that stands at times; return those at which a search is due."""
    due = []
    for now in times:
        note(watch, now, **conditions)
        if watch.is_search_due(now, is_obstructed=False):
            due.append(now)
    return due


def test_a_robot_that_stands_waits_and_searches_once_a_second():
    watch = ProgressWatch(10.0)
    times = [10.0 + 0.25 * k for k in range(14)]
    assert searches(watch, times) == [11.0, 12.0, 13.0]
    assert watch.waiting_time(13.25) == pytest.approx(3.25)
    note(watch, 13.5, place=0.01)
    assert watch.waiting_time(13.5) == 0.0


def test_an_obstacle_in_the_way_is_searched_around_at_once():
    watch = ProgressWatch(0.0)
    note(watch, 0.25, place=0.1)
    assert watch.is_search_due(0.25, is_obstructed=True)
    note(watch, 0.5, place=0.2)
    assert not watch.is_search_due(0.5, is_obstructed=True)
    assert watch.is_search_due(0.25 + BLOCKED, is_obstructed=True)


def test_a_limit_that_holds_the_robot_excuses_it_but_starts_one_search():
    watch = ProgressWatch(0.0)
    times = [0.25 * k for k in range(1, 20)]
    assert searches(watch, times, is_held=True, is_excused=True) == [1.0]
    assert watch.waiting_time(times[-1]) == pytest.approx(0.0)


def test_a_robot_that_creeps_waits_until_it_goes_on():
    watch = ProgressWatch(0.0)
    for k in range(200):
        note(watch, 0.1 * k, place=5e-5 * k)
    assert watch.waiting_time(19.9) == pytest.approx(19.9)
    note(watch, 20.0, place=0.0125)
    assert watch.waiting_time(20.0) == 0.0
