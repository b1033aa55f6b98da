"""Topics as the README's tables have them."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def documented_topics():
    """Types (PACKAGE/NAME) by relative topic."""
    topics = {}
    for line in (ROOT / "README.md").read_text().splitlines():
        cells = line.split("|")
        if len(cells) < 4 or not re.match(r" `[\w/]+`", cells[1]):
            continue
        names = re.findall(r"`([\w/]+)`", cells[1])
        kinds = re.findall(r"`(\w+_msgs/\w+)`", cells[2])
        if kinds:
            kinds = kinds if len(kinds) == len(names) else kinds[:1] * len(names)
            for name, kind in zip(names, kinds, strict=True):
                topics.setdefault(name, set()).add(kind)
    assert len(topics) > 30
    return topics
