"""How many examples a fuzz test makes."""

import os

#: Environment variable with the number of examples of each fuzz test that is run
VARIABLE = "OMNIMAN_FUZZ"


def examples(suite: int) -> int:
    """Return the number of frames, messages or events that a fuzz test makes in all.

    Args:
        suite: Number in the suite, which holds where the environment does not give another one.
    """
    return int(os.environ.get(VARIABLE, suite))
