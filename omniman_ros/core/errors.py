"""Exceptions of the package: one base, subclasses that carry data."""


class OmnimanError(Exception):
    """Base of every error that this package raises on purpose."""


class ParameterError(OmnimanError, ValueError):
    """A parameter has a value that is refused.

    Attributes:
        name: Full name of the parameter, groups joined by dots.
        value: The value that was refused.
    """

    def __init__(self, name: str, value: object, reason: str) -> None:
        super().__init__(f"parameter '{name}' = {value!r} is refused: {reason}")
        self.name = name
        self.value = value
        self.reason = reason


class GeometryError(OmnimanError, ValueError):
    """The wheels do not make an omnidirectional platform.

    Attributes:
        wheel: Name of the wheel at fault, or None if it is all of them together.
    """

    def __init__(self, message: str, wheel: str | None = None) -> None:
        super().__init__(message)
        self.wheel = wheel


class InputError(OmnimanError, ValueError):
    """A message or measurement has content that cannot be used; it moves nothing."""
