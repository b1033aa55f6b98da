import numpy as np
import pytest

from omniman_ros.surroundings.ellipses import Ellipses, inflated

PHI = np.linspace(0, 2 * np.pi, 721)


def two(time=1.0, growth=(0.1, 0.0)):
    return Ellipses(
        time,
        centers=np.array([[1.0, 2], [3, 4]]),
        velocities=np.array([[0.5, -1], [0, 0]]),
        semi_axes=np.array([[0.3, 0.3], [1.0, 0.2]]),
        angles=np.array([0.0, 0.7]),
        growth=np.array(growth),
    )


def widened(axes, margin):
    """Return the boundary of an ellipse offset by a radius along its outward normal."""
    circle = np.stack([np.cos(PHI), np.sin(PHI)])
    normal = circle / axes[:, None]
    return axes[:, None] * circle + margin * normal / np.hypot(*normal)


def test_inflated_ellipse_tightly_contains_the_offset_ellipse():
    rng = np.random.default_rng(1)
    for axes, margin in zip(
        rng.uniform(0.05, 2, (300, 2)), rng.uniform(0.01, 1, 300), strict=True
    ):
        level = np.hypot(*(widened(axes, margin) / inflated(axes, margin)[:, None]))
        assert level.max() <= 1 + 1e-12
        assert level.max() > 1 - 1e-4  # no larger than necessary


def test_adding_the_margin_to_the_axes_would_not_contain_the_offset_ellipse():
    axes = np.array([1.0, 0.2])
    assert np.hypot(*(widened(axes, 0.3) / (axes + 0.3)[:, None])).max() > 1.02


def test_inflated_ellipse_has_the_minimum_trace_of_its_family():
    axes, margin = np.array([1.1, 0.3]), 0.25
    s = np.linspace(0.01, 20, 5000)
    traces = (1 + 1 / s) * (axes**2).sum() + 2 * (1 + s) * margin**2
    assert (inflated(axes, margin) ** 2).sum() == pytest.approx(traces.min(), rel=1e-5)


def test_circle_grows_by_exactly_the_margin():
    radius = np.array([0.01, 0.3, 5])
    grown = inflated(np.stack([radius, radius], axis=1), np.array([0.2, 0.1, 1]))
    np.testing.assert_allclose(grown, [[0.21] * 2, [0.4] * 2, [6] * 2], rtol=1e-14)


def test_zero_margin_leaves_the_ellipse_unchanged():
    axes = np.random.default_rng(2).uniform(0.01, 3, (50, 2))
    np.testing.assert_allclose(inflated(axes, 0.0), axes, rtol=1e-15)


def test_inflated_broadcasts_margins_over_ellipses():
    axes = np.random.default_rng(3).uniform(0.1, 1, (4, 2))
    margins = np.random.default_rng(4).uniform(0, 1, (5, 4))
    grown = inflated(axes, margins)
    assert grown.shape == (5, 4, 2)
    np.testing.assert_allclose(grown[3, 2], inflated(axes[2], margins[3, 2]))
    assert (np.diff(inflated(axes[0], np.linspace(0, 1, 20)), axis=0) > 0).all()


def test_centres_move_at_constant_velocity_forwards_and_backwards_in_time():
    centers = two().centers_at(np.array([0.0, 1, 3]))
    np.testing.assert_allclose(centers[:, 0], [[0.5, 3], [1, 2], [2, 0]])
    np.testing.assert_allclose(centers[:, 1], [[3, 4]] * 3)


def test_margin_grows_with_prediction_time_and_not_into_the_past():
    ellipses = two()
    axes = ellipses.axes_at(np.array([0.0, 1, 3]), margin=0.05)
    assert axes.shape == (3, 2, 2)
    np.testing.assert_allclose(axes[:, 0, 0], [0.35, 0.35, 0.55])
    np.testing.assert_allclose(axes[:, 1], np.tile(inflated(ellipses.semi_axes[1], 0.05), (3, 1)))


def test_axes_are_as_observed_without_margin_and_growth():
    ellipses = two(growth=(0.0, 0.0))
    axes = ellipses.axes_at(np.array([1.0, 9]))
    np.testing.assert_allclose(axes, np.tile(ellipses.semi_axes, (2, 1, 1)), rtol=1e-15)


@pytest.mark.parametrize("wanted", [np.array([False, True]), np.array([1])])
def test_select_keeps_every_field_by_mask_or_index(wanted):
    ellipses, one = two(), two().select(wanted)
    assert len(one) == 1
    assert one.time == ellipses.time
    for name in ("centers", "velocities", "semi_axes", "angles", "growth"):
        np.testing.assert_array_equal(getattr(one, name), getattr(ellipses, name)[1:])


def test_empty_ellipses_have_zero_length_shapes():
    none, times = Ellipses.none(2.0), np.array([2.0, 3, 4])
    assert len(none) == 0
    assert none.time == 2.0
    assert none.centers_at(times).shape == (3, 0, 2)
    assert none.axes_at(times, 0.1).shape == (3, 0, 2)
    assert len(two().select(np.zeros(2, dtype=bool))) == 0


def test_circles_keep_their_size_and_may_share_velocity_and_radius():
    one = Ellipses.circles(1.0, [[0.0, 1.0], [2.0, 3.0]], [0.5, 0.0], 0.3)
    np.testing.assert_array_equal(one.centers_at(np.array([3.0]))[0], [[1.0, 1.0], [3.0, 3.0]])
    np.testing.assert_allclose(one.axes_at(np.array([9.0]), 0.1)[0], np.full((2, 2), 0.4))
    own = Ellipses.circles(0.0, [[0.0, 1.0], [2.0, 3.0]], [[0.0, 1.0], [1.0, 0.0]], [0.3, 0.4])
    np.testing.assert_array_equal(own.semi_axes, [[0.3, 0.3], [0.4, 0.4]])
    assert len(Ellipses.circles(0.0, [], [0.0, 0.0], 0.3)) == 0
