"""Choice of a ROS domain that no other robot uses, for a demo or a test."""

import fcntl
import os
import random
import socket
import tempfile
import time
from collections.abc import MutableMapping
from contextlib import suppress
from pathlib import Path

#: Domains whose ports lie above the ephemeral ports of Linux; they are rarely used
HIGH_DOMAINS = range(215, 233)
#: Domains whose ports lie below the ephemeral ports of Linux, without those of the nodes' tests
LOW_DOMAINS = range(1, 40)
#: Number of participants that are looked for: the first ones may have ended before the others
MOST_PARTICIPANTS = 32
#: Time for which a chosen domain is not chosen again [s]: processes take some to come up in it
RESERVATION = 60.0


def is_free(domain: int) -> bool:
    """Return whether no participant on this machine uses a domain.

    Such a participant would occupy two unicast ports of the domain (RTPS 9.6.1.1).
    """
    for participant in range(MOST_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            except OSError:
                return False
    return True


def _reserve(domain: int) -> bool:
    """Reserve a domain for `RESERVATION`; return False if this or another process has done so."""
    folder = Path(tempfile.gettempdir(), f"omniman_ros_domains_{os.getuid()}")
    with suppress(OSError):  # without a place for it, nothing is reserved
        folder.mkdir(exist_ok=True)
        with open(folder / str(domain), "a") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            known = os.fstat(file.fileno())
            if known.st_size and 0.0 <= time.time() - known.st_mtime < RESERVATION:
                return False
            file.write(".")
    return True


def free_domain() -> int:
    """Return a domain that no participant on this machine uses, nor soon will.

    It is reserved for this user's processes until its own have come up. If no domain is free, the
    result is one that is in use.
    """
    candidates = [
        *random.sample(HIGH_DOMAINS, len(HIGH_DOMAINS)),
        *random.sample(LOW_DOMAINS, len(LOW_DOMAINS)),
    ]
    chosen = (domain for domain in candidates if is_free(domain) and _reserve(domain))
    return next(chosen, candidates[0])


def isolate_ros_domain(environment: MutableMapping[str, str]) -> int:
    """Choose and return a free domain on this machine alone, unless the user has set them."""
    environment.setdefault("ROS_DOMAIN_ID", str(free_domain()))
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return int(environment["ROS_DOMAIN_ID"])
