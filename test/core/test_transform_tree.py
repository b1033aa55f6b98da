"""Tree of frames: lookups by the rules of tf2, and refusals."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import Transform
from omniman_ros.core.transform_tree import (
    CACHE_TIME,
    MAX_DEPTH,
    MAX_FRAMES,
    MAX_SAMPLES,
    FutureTransformError,
    NotConnectedError,
    PastTransformError,
    TransformTree,
    UnknownFrameError,
)

T0 = 1_700_000_000.0


def planar(x: float, y: float = 0.0, theta: float = 0.0) -> Transform:
    return Transform.of_planar((x, y, theta))


def place(tree: TransformTree, parent: str, child: str, time: float, *pose: float) -> None:
    tree.insert(parent, child, time, planar(*pose), is_static=False)


@pytest.fixture
def tree() -> TransformTree:
    """map -> odom (turns, 10 Hz), odom -> base_link (drives at 1 m/s, 100 Hz) -> laser (static);
    map -> dock (static); a frame elsewhere."""
    made = TransformTree()
    for i in range(11):
        place(made, "map", "odom", T0 + 0.1 * i, 1.0, 2.0, 0.1 * i)
    for i in range(101):
        place(made, "odom", "base_link", T0 + 0.01 * i, 0.01 * i)
    made.insert("base_link", "laser", 0.0, planar(0.2, 0.0, math.pi), is_static=True)
    made.insert("map", "dock", 0.0, planar(5.0, 0.0, 0.0), is_static=True)
    made.insert("moon", "crater", 0.0, planar(1.0), is_static=True)
    return made


def test_a_chain_is_composed_at_the_time_asked_for(tree):
    found = tree.lookup("map", "laser", T0 + 0.555)
    heading = 0.555
    reach = 0.755
    assert found.planar()[:2] == pytest.approx(
        (1 + reach * math.cos(heading), 2 + reach * math.sin(heading))
    )
    assert math.remainder(found.planar()[2] - heading - math.pi, math.tau) == pytest.approx(
        0, abs=1e-6
    )


def test_frames_with_a_common_ancestor_are_related_both_ways(tree):
    there = tree.lookup("dock", "laser", T0 + 0.3)
    back = tree.lookup("laser", "dock", T0 + 0.3)
    assert (there @ back).matrix() == pytest.approx(np.eye(4))
    assert tree.lookup("laser", "laser", T0 - 99.0) == Transform()


def test_without_a_time_every_frame_is_where_it_was_last(tree):
    place(tree, "odom", "base_link", T0 + 5.0, 7.0)
    assert tree.lookup("map", "base_link", None).planar() == pytest.approx(
        (1 + 7 * math.cos(1.0), 2 + 7 * math.sin(1.0), 1.0)
    )


def test_nothing_is_extrapolated(tree):
    with pytest.raises(FutureTransformError, match=r"'odom' to 'map' is 0\.100 s older") as future:
        tree.lookup("map", "odom", T0 + 1.1)
    with pytest.raises(PastTransformError, match=r"begin 0\.100 s later") as past:
        tree.lookup("map", "odom", T0 - 0.1)
    assert future.value.may_come and not past.value.may_come


def test_the_ends_of_the_history_are_within(tree):
    assert tree.lookup("map", "odom", T0).planar()[2] == pytest.approx(0.0)
    assert tree.lookup("map", "odom", T0 + 1.0).planar()[2] == pytest.approx(1.0)


def test_a_static_frame_is_where_it_is_at_all_times(tree):
    assert tree.lookup("map", "dock", T0 + 1e6).translation == (5.0, 0.0, 0.0)
    assert tree.lookup("map", "dock", -1e6).translation == (5.0, 0.0, 0.0)


def test_unknown_and_unconnected_frames_are_told_apart(tree):
    with pytest.raises(UnknownFrameError, match="frame 'attic'"):
        tree.lookup("odom", "attic", None)
    with pytest.raises(UnknownFrameError, match="frame 'attic'"):
        tree.lookup("attic", "odom", None)
    with pytest.raises(NotConnectedError, match="'crater' with 'odom'"):
        tree.lookup("odom", "crater", None)


def test_a_loop_is_no_connection(tree):
    place(tree, "a", "b", T0, 1.0)
    place(tree, "b", "a", T0, 1.0)
    with pytest.raises(NotConnectedError, match="loop"):
        tree.lookup("map", "a", None)
    place(tree, "f0", "f1", T0, 0.0)
    for i in range(1, MAX_DEPTH - 1):
        place(tree, f"f{i}", f"f{i + 1}", T0, 1.0)
    assert tree.lookup("f0", f"f{MAX_DEPTH - 1}", T0).translation[0] == MAX_DEPTH - 2


@pytest.mark.parametrize(
    ("first", "second", "common"),
    [
        ("odom", "map", "map"),
        ("odom", "dock", "map"),
        ("odom", "laser", "odom"),
        ("odom", "odom", "odom"),
    ],
)
def test_the_nearest_common_ancestor(tree, first, second, common):
    assert tree.ancestor(first, second) == common == tree.ancestor(second, first)


def test_samples_that_come_late_are_sorted_in(tree):
    place(tree, "map", "odom", T0 + 2.0, 0.0, 0.0, 2.0)
    place(tree, "map", "odom", T0 + 1.5, 0.0, 0.0, 0.0)
    assert tree.lookup("map", "odom", T0 + 1.75).planar()[2] == pytest.approx(1.0)


def test_the_first_of_two_samples_of_a_time_counts(tree):
    place(tree, "map", "odom", T0 + 1.0, 9.0)
    assert tree.lookup("map", "odom", T0 + 1.0).planar()[2] == pytest.approx(1.0)


def test_the_history_is_bounded_in_time(tree):
    for i in range(1, 400):
        place(tree, "map", "odom", T0 + 1.0 + 0.1 * i, 0.0)
    newest = T0 + 40.9
    tree.lookup("map", "odom", newest - CACHE_TIME + 0.01)
    with pytest.raises(PastTransformError):
        tree.lookup("map", "odom", newest - CACHE_TIME - 0.01)
    place(tree, "map", "odom", newest - CACHE_TIME - 0.05, 9.0)
    assert len(tree._frames["odom"].times) <= 2 * CACHE_TIME / 0.1 + 2


def test_the_history_is_bounded_in_number(tree):
    for i in range(3 * MAX_SAMPLES):
        place(tree, "odom", "base_link", T0 + 2.0 + 1e-4 * i, 0.0)
        assert len(tree._frames["base_link"].times) <= MAX_SAMPLES + 1


def test_a_new_parent_replaces_the_old_one(tree):
    place(tree, "odom", "dock", T0, 3.0)
    assert tree.lookup("odom", "dock", None).translation[0] == 3.0
    assert tree.ancestor("dock", "odom") == "odom"


def test_age_is_that_of_the_frame_longest_silent(tree):
    place(tree, "odom", "base_link", T0 + 5.0, 7.0)
    assert tree.updated("map", "laser") == pytest.approx(T0 + 1.0)
    assert tree.updated("odom", "laser") == pytest.approx(T0 + 5.0)
    assert tree.updated("map", "dock") == math.inf == tree.updated("map", "map")


def test_a_transform_that_is_dated_ahead_is_no_younger_than_its_arrival(tree):
    now = T0 + 2.0
    for lead in (1.0, 0.5):  # the second one is out of order
        tree.insert("map", "odom", now + lead, planar(1.0), is_static=False, now=now)
    assert tree.updated("map", "odom") == now


def test_clearing_keeps_what_holds_for_ever(tree):
    tree.clear()
    assert tree.lookup("map", "dock", None).translation[0] == 5.0
    with pytest.raises(UnknownFrameError):
        tree.lookup("map", "odom", None)
    tree.clear(keep_static=False)
    assert not tree.is_child("dock")


BAD = {
    "no parent": ("", "a", T0, planar(0.0), "frames '' and 'a'"),
    "no child": ("a", "", T0, planar(0.0), "frames 'a' and ''"),
    "its own parent": ("a", "a", T0, planar(0.0), "frames 'a' and 'a'"),
    "NaN": ("a", "b", T0, planar(math.nan), "translation"),
    "far": ("a", "b", T0, planar(1e7), "translation"),
    "zero rotation": ("a", "b", T0, Transform(rotation=(0.0, 0.0, 0.0, 0.0)), "length 0"),
    "no time": ("a", "b", math.nan, planar(0.0), "time nan"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_transforms_are_refused_and_change_nothing(tree, case):
    *given, why = BAD[case]
    with pytest.raises(InputError, match=why):
        tree.insert(*given, is_static=False)
    assert not tree.is_child("a") and not tree.is_child("b")


def test_the_number_of_frames_is_bounded(tree):
    with pytest.raises(InputError, match="frames already"):
        for i in range(MAX_FRAMES + 1):
            place(tree, "map", f"f{i}", T0, 0.0)


def test_rotations_are_normalised(tree):
    tree.insert("map", "a", T0, Transform(rotation=(0.0, 0.0, 0.0, 1.04)), is_static=True)
    assert tree.lookup("map", "a", None).rotation == (0.0, 0.0, 0.0, 1.0)
