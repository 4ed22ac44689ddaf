"""The same draws on every run, and no time limit that a busy machine could break."""

from hypothesis import settings

settings.register_profile("fishmj", derandomize=True, deadline=None)
settings.load_profile("fishmj")
