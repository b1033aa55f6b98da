"""What the demo hears."""

from types import SimpleNamespace

from std_msgs.msg import Float64

from omniman_ros.cli.recorder import Recorder


def recorder():
    return Recorder(SimpleNamespace(create_subscription=lambda *given: None))


def hear(heard, *progress):
    for value in progress:
        heard._on_progress(Float64(data=value))


def test_a_motion_arrives():
    heard = recorder()
    heard.begin()
    hear(heard, 0.0, 0.4)
    assert heard.progress == 0.4 and not heard.arrived
    hear(heard, 1.0)
    assert heard.arrived


def test_the_late_end_of_the_motion_before_is_not_that_of_this_one():
    heard = recorder()
    heard.begin()
    hear(heard, 0.5, 1.0)
    heard.begin()
    hear(heard, 1.0)
    assert not heard.arrived and heard.progress == 0.0
    hear(heard, 0.1, 1.0)
    assert heard.arrived
