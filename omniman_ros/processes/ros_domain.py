"""Choice of a ROS domain that no other robot uses, for a demo or a test."""

import random
import socket
from collections.abc import MutableMapping

#: Domains whose ports lie above the ephemeral ports of Linux; they are rarely used
HIGH_DOMAINS = range(215, 233)
LOW_DOMAINS = range(1, 102)  #: Domains whose ports lie below the ephemeral ports of Linux


def is_free(domain: int) -> bool:
    """Return whether no participant on this machine uses a domain.

    Such a participant would occupy the domain's first unicast ports (RTPS 9.6.1.1).
    """
    for offset in (10, 11):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + offset))
            except OSError:
                return False
    return True


def free_domain() -> int:
    """Return a domain that no participant on this machine uses.

    The choice is random, so that two processes that choose at the same time get different
    domains. If no domain is free, the result is one that is in use.
    """
    candidates = [
        *random.sample(HIGH_DOMAINS, len(HIGH_DOMAINS)),
        *random.sample(LOW_DOMAINS, len(LOW_DOMAINS)),
    ]
    return next(filter(is_free, candidates), candidates[0])


def isolate_ros_domain(environment: MutableMapping[str, str]) -> int:
    """Choose and return a free domain on this machine alone, unless the user has set them."""
    environment.setdefault("ROS_DOMAIN_ID", str(free_domain()))
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return int(environment["ROS_DOMAIN_ID"])
