"""Policies: what users import of `fishmj.control.policy`."""

from fishmj.control.policy import SHIPPED, Policy

__all__ = ["SHIPPED", "Policy"]
