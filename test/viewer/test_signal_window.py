import numpy as np

from omniman_ros.viewer.signal_window import SignalWindow


def test_a_window_holds_the_last_seconds():
    window = SignalWindow(2, span=2.0, rate=10.0)
    for i in range(50):
        window.sample(100.0 + 0.1 * i, np.array([i, -i], dtype=float))
    times, first, second = window.columns(104.9)
    assert times[0] >= -2.0 and times[-1] == 0.0
    assert len(times) == 20
    assert np.allclose(np.diff(times), 0.1)
    assert first.tolist() == list(range(30, 50))
    assert (second == -first).all()


def test_a_window_omits_samples_older_than_its_span():
    window = SignalWindow(1, span=2.0, rate=10.0)
    window.sample(100.0, np.array([1.0]))
    window.sample(103.0, np.array([2.0]))
    times, values = window.columns(103.0)
    assert times.tolist() == [0.0] and values.tolist() == [2.0]
    assert [len(column) for column in window.columns(200.0)] == [0, 0]


def test_an_early_sample_replaces_the_previous_one():
    window = SignalWindow(1, span=2.0, rate=10.0)
    for i in range(100):
        window.sample(100.0 + 0.001 * i, np.array([float(i)]))
    times, values = window.columns(100.1)
    assert len(times) == 2
    assert values[-1] == 99.0
