"""Names that the SROS2 policy of the package allows to each node."""

import xml.etree.ElementTree as ET

from test.config.documented import ROOT

FILE = ROOT / "config" / "sros2" / "policy.xml"
RULES = (
    ("topics", "publish"),
    ("topics", "subscribe"),
    ("services", "reply"),
    ("services", "request"),
    ("actions", "execute"),
)


def enclaves():
    """Return the profile of each enclave, by its path."""
    policy = ET.parse(FILE).getroot()
    assert policy.get("version") == "0.2.0"
    found = {}
    for enclave in policy.iterfind("enclaves/enclave"):
        (profile,) = enclave.iterfind("profiles/profile")
        found[enclave.get("path")] = profile
    return found


def absolute(name, node):
    """Return the full name of a name in a node's profile in the root namespace, as sros2 does."""
    if name.startswith("~"):
        return f"/{node}{name[1:]}"
    return name if name.startswith("/") else f"/{name}"


def allowed(node):
    """Return the full names that a node may use, by rule."""
    profile = enclaves()[f"/omniman/{node}"]
    assert (profile.get("ns"), profile.get("node")) == ("/", node)
    return {
        (kind, right): {
            absolute(entry.text, node)
            for group in profile.iterfind(kind)
            if group.get(right) == "ALLOW"
            for entry in group
        }
        for kind, right in RULES
    }


def used(node, running):
    """Return the full names that a running node uses now, by rule; but no actions."""
    where = node, "/"
    queries = {
        ("topics", "publish"): running.get_publisher_names_and_types_by_node,
        ("topics", "subscribe"): running.get_subscriber_names_and_types_by_node,
        ("services", "reply"): running.get_service_names_and_types_by_node,
        ("services", "request"): running.get_client_names_and_types_by_node,
    }
    return {rule: {name for name, _ in query(*where)} for rule, query in queries.items()}
