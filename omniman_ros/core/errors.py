"""Exceptions of the package: one base class, and subclasses that carry data."""


class OmnimanError(Exception):
    """Base of every error that this package raises on purpose."""


class ParameterError(OmnimanError, ValueError):
    """The value of a parameter is refused; its full name joins groups by dots."""

    def __init__(self, name: str, value: object, reason: str) -> None:
        super().__init__(f"parameter '{name}' = {value!r} is refused: {reason}")
        self.name = name
        self.value = value
        self.reason = reason


class GeometryError(OmnimanError, ValueError):
    """The wheels do not make an omnidirectional platform; `wheel` names a single one at fault."""

    def __init__(self, message: str, wheel: str | None = None) -> None:
        super().__init__(message)
        self.wheel = wheel


class InputError(OmnimanError, ValueError):
    """The content of a message or a measurement cannot be used; it causes no motion."""


class FileError(OmnimanError):
    """A file cannot be used as what it is given for; `line`, if any, is counted from 1."""

    def __init__(self, file: str, line: int | None, reason: str) -> None:
        super().__init__(f"{file}{'' if line is None else f':{line}'}: {reason}")
        self.file = file
        self.line = line
        self.reason = reason
