"""What a user is told about what is in the way."""

from omniman_ros.planning.whole_body.obstruction import TEXTS, Cause, Obstruction, status_values


def test_the_sentence_names_place_part_and_obstacle():
    found = Obstruction(Cause.MOVING, 1.234, "forearm_link", "obstacle people/3")
    expected = (
        "1.23 m along the path, forearm_link has no room beside obstacle people/3, which moves"
    )
    assert str(found) == expected


def test_each_cause_has_a_sentence():
    assert set(TEXTS) == set(Cause)
    assert all(Obstruction(cause, 0.0, "a", "b").reason for cause in Cause)


def test_values_have_the_same_keys_whether_something_is_in_the_way_or_not():
    found = dict(status_values(Obstruction(Cause.STANDING, 0.12345, "platform", "obstacle 1")))
    assert list(found.values()) == ["standing obstacle", 0.123, "platform", "obstacle 1"]
    nothing = dict(status_values(None))
    assert list(nothing) == list(found)
    assert set(nothing.values()) == {""}
