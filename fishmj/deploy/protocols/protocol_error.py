"""The error of all protocols."""

from fishmj.base.errors import FishmjError


class ProtocolError(FishmjError, ValueError):
    """Bytes that are no valid message, or a value that does not fit into one. One line: what, got, expected."""
