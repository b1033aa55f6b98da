"""Errors of the arm's edge."""

from omniman_ros.core.errors import OmnimanError


class ProtocolError(OmnimanError):
    """The peer says what cannot be, or refuses what is needed; the connection is of no use."""
