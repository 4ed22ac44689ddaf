"""Readers of four published data sets: rows of `fishmj.log.importers.registry` name them, `log import` uses them."""
