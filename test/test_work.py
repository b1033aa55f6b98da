import sys

import pytest
from std_msgs.msg import Header

from test.work import calls


def test_calls_of_python_and_of_c_are_counted():
    def squares():
        for k in range(10):  # one call of C
            pow(k, 2)

    assert calls(lambda: None) == 1
    assert calls(squares) in (11, 12)  # range is a type, which no Python reports before 3.12
    assert calls(lambda: squares()) == calls(squares) + 1


def test_counting_ends_with_the_work_even_if_it_fails():
    def fail():
        raise ValueError

    with pytest.raises(ValueError):
        calls(fail)
    assert sys.getprofile() is None


def test_what_a_class_of_messages_does_inside_does_not_count():
    messages = []
    assert calls(lambda: messages.append(Header(frame_id="odom"))) == 2  # the lambda, append
