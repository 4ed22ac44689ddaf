"""The one error of all protocols."""

from fishmj.base.errors import FishmjError


class ProtocolError(FishmjError, ValueError):
    """Bytes that are no message, or a value that a message cannot carry. One line: what, got, expected."""
