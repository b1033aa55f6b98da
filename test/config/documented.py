"""Topics and services as the pages of the nodes list them."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "nodes"


def documented_interface(node, heading):
    """Types (PACKAGE/NAME) by name, from the table below a heading of a node's page."""
    page = (PAGES / f"{node}.md").read_text(encoding="utf-8")
    section = re.search(rf"^## {heading}\b.*?$(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
    rows = section[1] if section else ""
    return dict(re.findall(r"^\| `([~/\w]+)` \| `(\w+/\w+)` \|", rows, re.MULTILINE))


def documented_topics():
    """Sets of types (PACKAGE/NAME) by relative topic, over all nodes."""
    topics = {}
    for path in PAGES.glob("*.md"):
        for heading in ("Subscribed topics", "Published topics"):
            for name, kind in documented_interface(path.stem, heading).items():
                topics.setdefault(name, set()).add(kind)
    assert len(topics) > 30
    return topics
