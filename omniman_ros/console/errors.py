"""The exception with which a command ends when it fails."""


class CommandError(Exception):
    """Ends a command with a message for the user.

    The message says in one line what went wrong. The exit code is 1, or 2 if the command line is
    invalid.
    """

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.code = code
