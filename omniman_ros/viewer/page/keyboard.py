"""Driving with the keyboard: a script of the page that presses its buttons while keys are down.

viser reports no key to its server, and uses W, A, S, D, Q, E and the arrows for its camera. The
script therefore simulates a finger: it sends the pointer events of a press to the buttons, so that
heartbeat, release and dead man's switch are those of the buttons.

A panel of viser sends only the latest message every 50 ms: of two buttons that are held at once,
one would lose its heartbeats. So there is a button for each chord of up to three keys, and
only one of them is pressed at a time.
"""

import json
from collections.abc import Mapping
from itertools import product

KEYS = {
    "forward": "I",
    "back": "K",
    "left": "J",
    "right": "L",
    "turn_left": "U",
    "turn_right": "O",
}  #: Key of each motion: the letter that a US keyboard has at the key's place
#: Pairs of opposite motions, of which at most one is part of a chord
_AXES = (("forward", "back"), ("left", "right"), ("turn_left", "turn_right"))
CHORDS = tuple(
    chord
    for choice in product(*((None, *axis) for axis in _AXES))
    if (chord := tuple(motion for motion in choice if motion is not None))
)  #: Combinations of motions that can be held at once, in the order of the axes
KEY_DOWN_ATTRIBUTE = "data-held"  #: Attribute of a motion button while its key is down

# The script uses key codes rather than characters: they are the same at release, even if shift was
# pressed in between. The listeners are attached once: a page that reconnects only has new buttons.
_SCRIPT = """
(() => {
  const page = window;
  const newSettings = {{SETTINGS}};
  if (page.omnimanKeys) { page.omnimanKeys.use(newSettings); return; }
  let settings = newSettings, pressed = null;
  const down = new Set();
  const find = id => document.getElementById(id);
  const chord = () => settings.axes.map(([first, second]) => {
    const a = down.has(settings.codes[first]), b = down.has(settings.codes[second]);
    return a === b ? null : a ? first : second;
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
      if (button) button.toggleAttribute("{{KEY_DOWN}}", down.has(settings.codes[motion]));
    }
  };
  const update = () => {
    const id = settings.buttons[chord()] || null;
    if (id !== pressed) {
      if (pressed) send(pressed, "pointerup");
      // A click reports the release; a new chord releases the motions that are not part of it.
      if (pressed && !id && find(pressed)) find(pressed).click();
      if (id) send(id, "pointerdown");
      pressed = id;
    }
    mark();
  };
  const warn = () => {
    const notice = document.createElement("div");
    notice.textContent = "NOT STOPPED: the panel with Stop is folded, unfold it";
    notice.style.cssText = "position:fixed;z-index:9999;top:40%;left:0;right:0;padding:1em;"
      + "text-align:center;font:600 1.2em sans-serif;color:white;background:#c92a2a";
    document.body.append(notice);
    setTimeout(() => notice.remove(), 4000);
  };
  const release = () => { down.clear(); update(); };
  const acceptsText = element => {
    if (!element || !element.matches) return false;
    return element.isContentEditable
      || element.matches("textarea, select, input:not([type=checkbox]):not([type=radio])"
        + ":not([type=button]):not([type=range])");
  };
  const acceptsNumber = element => element.matches && element.matches(
    "input[inputmode=decimal], input[inputmode=numeric], input[type=number]");
  const consume = event => { event.preventDefault(); event.stopPropagation(); };
  const modified = event => event.ctrlKey || event.altKey || event.metaKey;
  page.addEventListener("keydown", event => {
    // While a modifier is down, the release of a letter may never be reported.
    if (modified(event)) { release(); return; }
    const target = event.target;
    if (event.code === "Space") {
      // A space is never part of a number: Stop works in number inputs too.
      if (acceptsText(target) && !acceptsNumber(target)) return;
      consume(event);
      if (event.repeat) return;
      release();
      const stop = find(settings.stop);
      if (stop) stop.click(); else warn();
      return;
    }
    if (acceptsText(target) || !Object.values(settings.codes).includes(event.code)) return;
    consume(event);
    if (event.repeat || down.has(event.code)) return;
    down.add(event.code);
    update();
  }, true);
  page.addEventListener("keyup", event => {
    const target = event.target;
    if (event.code === "Space" && !(acceptsText(target) && !acceptsNumber(target))) consume(event);
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


def chord_name(chord: tuple[str, ...]) -> str:
    """Return the name of a chord in the script: its motions, joined by "+"."""
    return "+".join(chord)


def keyboard_script(
    buttons: Mapping[tuple[str, ...], str], marks: Mapping[str, str], stop: str
) -> str:
    """Return the JavaScript that connects the keyboard to a page's buttons, given by their ids."""
    settings = {
        "axes": _AXES,
        "codes": {motion: f"Key{key}" for motion, key in KEYS.items()},
        "buttons": {chord_name(chord): element for chord, element in buttons.items()},
        "marks": dict(marks),
        "stop": stop,
    }
    script = _SCRIPT.replace("{{SETTINGS}}", json.dumps(settings))
    return script.replace("{{KEY_DOWN}}", KEY_DOWN_ATTRIBUTE)
