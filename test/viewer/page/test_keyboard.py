import json
import re

from omniman_ros.viewer.hold_to_drive import MOTIONS
from omniman_ros.viewer.page.keyboard import CHORDS, KEYS, chord_name, keyboard_script

CAMERA_KEYS = set("WASDQE")  #: Keys of viser's camera, besides the arrows


def script(stop='st"op'):
    buttons = {chord: f"id-{chord_name(chord)}" for chord in CHORDS}
    return keyboard_script(buttons, {motion: f"mark-{motion}" for motion in KEYS}, stop)


def settings():
    return json.loads(re.search(r"const newSettings = (\{.*\});", script())[1])


def test_every_motion_has_a_key_of_its_own_that_the_camera_does_not_use():
    assert set(KEYS) == set(MOTIONS)
    assert len(set(KEYS.values())) == len(KEYS)
    assert not CAMERA_KEYS & set(KEYS.values())


def test_there_is_a_chord_for_every_combination_of_motions():
    assert len(set(CHORDS)) == 3**3 - 1
    for chord in CHORDS:
        twist = [sum(MOTIONS[motion][axis] for motion in chord) for axis in range(3)]
        assert sum(abs(value) for value in twist) == len(chord), "two of them cancel"


def test_the_script_contains_all_element_ids_and_no_placeholder():
    found = settings()
    assert found["stop"] == 'st"op'
    assert found["codes"]["forward"] == "KeyI"
    assert {found["buttons"][chord_name(chord)] for chord in CHORDS} == {
        f"id-{chord_name(chord)}" for chord in CHORDS
    }
    assert found["marks"] == {motion: f"mark-{motion}" for motion in KEYS}
    assert "{{" not in script()


def test_the_script_joins_the_axes_as_the_chords_are_named():
    found = settings()
    joined = ["+".join(chord) for chord in found["axes"]]
    assert joined == ["forward+back", "left+right", "turn_left+turn_right"]
    assert "forward+left+turn_right" in found["buttons"]
