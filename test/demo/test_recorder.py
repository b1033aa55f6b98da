"""Progress of motions as the recorder sees it."""

from types import SimpleNamespace

from std_msgs.msg import Float64

from omniman_ros.demo.recorder import Recorder


def new_recorder():
    recorder = Recorder(SimpleNamespace(create_subscription=lambda *args: None), lambda: 0.0)
    recorder.begin_motion()
    return recorder


def report(recorder, *progress):
    for value in progress:
        recorder.on_progress(Float64(data=value))


def test_a_motion_arrives_when_its_progress_is_complete():
    recorder = new_recorder()
    report(recorder, 0.0, 0.4)
    assert recorder.progress == 0.4 and not recorder.has_arrived
    report(recorder, 1.0)
    assert recorder.has_arrived


def test_a_late_end_of_the_motion_before_does_not_count():
    recorder = new_recorder()
    report(recorder, 0.5, 1.0)
    recorder.begin_motion()
    report(recorder, 1.0)
    assert not recorder.has_arrived and recorder.progress == 0.0
    report(recorder, 0.1, 1.0)
    assert recorder.has_arrived
