"""Driving with the keyboard: a script of the page that presses its buttons while keys are down.

viser tells its server of no key, and has W, A, S, D, Q, E and the arrows for its camera. The
script therefore stands in for a finger: it sends the buttons the pointer events of a press, so
that heartbeat, release and dead man's switch are those of the buttons.

A panel of viser's sends one message in 50 ms, the latest: of two buttons that are held at once
the heartbeats of one get lost. So there is a button for each chord, of up to three keys, and one
at a time is pressed.
"""

import json
from collections.abc import Mapping
from itertools import product

KEYS = {
    "forward": "I", "back": "K", "left": "J", "right": "L", "turn_left": "U", "turn_right": "O",
}  # fmt: skip
"""Motion to key, a letter: it is meant where a US keyboard has it."""
_AXES = (("forward", "back"), ("left", "right"), ("turn_left", "turn_right"))
CHORDS = tuple(
    chord
    for choice in product(*((None, *axis) for axis in _AXES))
    if (chord := tuple(motion for motion in choice if motion is not None))
)
"""Motions that can be asked for at once, in the order of the axes."""
HELD = "data-held"
"""Attribute of a button that shows that its key is down."""

# Codes rather than characters: they are the same at release, whatever shift was down meanwhile.
# Once attached the listeners stay: a page that comes back brings new buttons, not new listeners.
_SCRIPT = """
(() => {
  const page = window;
  const wanted = {{SETTINGS}};
  if (page.omnimanKeys) { page.omnimanKeys.use(wanted); return; }
  let settings = wanted, pressed = null;
  const down = new Set();
  const find = id => document.getElementById(id);
  const chord = () => settings.axes.map(([one, other]) => {
    const a = down.has(settings.codes[one]), b = down.has(settings.codes[other]);
    return a === b ? null : a ? one : other;
  }).filter(motion => motion).join("+");
  const send = (id, kind) => {
    const button = find(id);
    if (button) button.dispatchEvent(new PointerEvent(kind, {
      bubbles: true, cancelable: true, button: 0, pointerId: 7151, isPrimary: false,
    }));
  };
  const mark = () => {
    for (const motion in settings.codes) {
      const button = find(settings.marks[motion]);
      if (button) button.toggleAttribute("{{HELD}}", down.has(settings.codes[motion]));
    }
  };
  const update = () => {
    const id = settings.buttons[chord()] || null;
    if (id !== pressed) {
      if (pressed) send(pressed, "pointerup");
      // A click tells the release; a new chord releases what it has not.
      if (pressed && !id && find(pressed)) find(pressed).click();
      if (id) send(id, "pointerdown");
      pressed = id;
    }
    mark();
  };
  const warn = () => {
    const said = document.createElement("div");
    said.textContent = "NOT STOPPED: the panel with Stop is folded, unfold it";
    said.style.cssText = "position:fixed;z-index:9999;top:40%;left:0;right:0;padding:1em;"
      + "text-align:center;font:600 1.2em sans-serif;color:white;background:#c92a2a";
    document.body.append(said);
    setTimeout(() => said.remove(), 4000);
  };
  const release = () => { down.clear(); update(); };
  const types = element => {
    if (!element || !element.matches) return false;
    return element.isContentEditable
      || element.matches("textarea, select, input:not([type=checkbox]):not([type=radio])"
        + ":not([type=button]):not([type=range])");
  };
  const numbers = element => element.matches && element.matches(
    "input[inputmode=decimal], input[inputmode=numeric], input[type=number]");
  const take = event => { event.preventDefault(); event.stopPropagation(); };
  const modified = event => event.ctrlKey || event.altKey || event.metaKey;
  page.addEventListener("keydown", event => {
    // With these down the release of a letter may never be told.
    if (modified(event)) { release(); return; }
    const target = event.target;
    if (event.code === "Space") {
      // A blank is no part of a number: Stop works there too.
      if (types(target) && !numbers(target)) return;
      take(event);
      if (event.repeat) return;
      release();
      const stop = find(settings.stop);
      if (stop) stop.click(); else warn();
      return;
    }
    if (types(target) || !Object.values(settings.codes).includes(event.code)) return;
    take(event);
    if (event.repeat || down.has(event.code)) return;
    down.add(event.code);
    update();
  }, true);
  page.addEventListener("keyup", event => {
    if (event.code === "Space" && !(types(event.target) && !numbers(event.target))) take(event);
    if (down.delete(event.code)) update();
  }, true);
  page.addEventListener("blur", release);
  page.addEventListener("pagehide", release);
  document.addEventListener("visibilitychange", release);
  page.omnimanKeys = { use: next => {
    if (JSON.stringify(next) === JSON.stringify(settings)) return;
    release();
    settings = next;
  } };
})()
"""


def name(chord: tuple[str, ...]) -> str:
    """What the script calls a chord."""
    return "+".join(chord)


def html(buttons: Mapping[tuple[str, ...], str], marks: Mapping[str, str], stop: str) -> str:
    """HTML that brings the script to a page; what a page's HTML has as scripts does not run.

    Args:
        buttons: Chord to the id of its button, see CHORDS.
        marks: Motion to the id of the button that shows that its key is down.
        stop: Id of the button that stops.
    """
    settings = {
        "axes": _AXES,
        "codes": {motion: f"Key{key}" for motion, key in KEYS.items()},
        "buttons": {name(chord): identity for chord, identity in buttons.items()},
        "marks": dict(marks),
        "stop": stop,
    }
    script = _SCRIPT.replace("{{SETTINGS}}", json.dumps(settings)).replace("{{HELD}}", HELD)
    quoted = script.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return f'<img src="data:," alt="" style="display:none" onerror="{quoted}">'
