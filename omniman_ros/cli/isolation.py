"""A ROS domain of one's own, so that a demo or a test meets no other robot."""

import random
import socket
from collections.abc import MutableMapping

SELDOM_USED = range(215, 233)
"""Domains whose ports lie above those that Linux gives out by itself; few people use them."""
USUAL = range(1, 102)
"""Domains whose ports lie below."""


def is_free(domain: int) -> bool:
    """Whether no participant on this machine has the first ports of a domain (RTPS 9.6.1.1)."""
    for offset in (10, 11):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + offset))
            except OSError:
                return False
    return True


def free_domain() -> int:
    """A domain that nobody on this machine uses; at random, so that two who choose differ."""
    candidates = [
        *random.sample(SELDOM_USED, len(SELDOM_USED)), *random.sample(USUAL, len(USUAL))
    ]  # fmt: skip
    return next(filter(is_free, candidates), candidates[0])


def isolate(environment: MutableMapping[str, str]) -> int:
    """Choose a domain, unless the user has set one, and keep to this machine; returns it."""
    environment.setdefault("ROS_DOMAIN_ID", str(free_domain()))
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return int(environment["ROS_DOMAIN_ID"])
