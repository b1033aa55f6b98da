"""How a command ends when it cannot do what it should."""


class CommandError(Exception):
    """Ends a command with a message for the user.

    Attributes:
        code: Exit code: 1, or 2 if the command line is wrong.
    """

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.code = code
