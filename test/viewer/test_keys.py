import json
import re
from html.parser import HTMLParser

from omniman_ros.viewer.hold import MOTIONS
from omniman_ros.viewer.keys import CHORDS, KEYS, html, name

CAMERA = set("WASDQE")
"""Keys of viser's camera, besides the arrows."""


class Attributes(HTMLParser):
    """The attributes of the one element."""

    def handle_starttag(self, tag, attributes):
        assert not hasattr(self, "found")
        self.found = tag, dict(attributes)


def parsed(stop='st"op'):
    buttons = {chord: f"id-{name(chord)}" for chord in CHORDS}
    reader = Attributes()
    reader.feed(html(buttons, {motion: f"seen-{motion}" for motion in KEYS}, stop))
    return reader.found


def settings(script):
    return json.loads(re.search(r"const wanted = (\{.*\});", script)[1])


def test_every_motion_has_a_key_of_its_own_that_the_camera_has_not():
    assert set(KEYS) == set(MOTIONS)
    assert len(set(KEYS.values())) == len(KEYS)
    assert not CAMERA & set(KEYS.values())


def test_there_is_a_chord_for_all_that_can_be_asked_for_at_once():
    assert len(set(CHORDS)) == 3**3 - 1
    for chord in CHORDS:
        twist = [sum(MOTIONS[motion][axis] for motion in chord) for axis in range(3)]
        assert sum(abs(value) for value in twist) == len(chord), "two of them cancel"


def test_the_html_survives_as_one_element_with_all_ids():
    tag, attributes = parsed()
    assert tag == "img"
    told = settings(attributes["onerror"])
    assert told["stop"] == 'st"op'
    assert told["codes"]["forward"] == "KeyI"
    assert {told["buttons"][name(chord)] for chord in CHORDS} == {
        f"id-{name(chord)}" for chord in CHORDS
    }
    assert told["marks"] == {motion: f"seen-{motion}" for motion in KEYS}
    assert "{{" not in attributes["onerror"]


def test_the_axes_are_joined_as_the_chords_are_named():
    told = settings(parsed()[1]["onerror"])
    picked = ["+".join(chord) for chord in told["axes"]]
    assert picked == ["forward+back", "left+right", "turn_left+turn_right"]
    assert "forward+left+turn_right" in told["buttons"]
