"""Readers of foreign recordings: each turns files into trials of our schema, stamps untouched, nothing resampled."""

from fishmj.log.importers.registry import FORMATS, Importer, read, sniff

__all__ = ["FORMATS", "Importer", "read", "sniff"]
