"""The commands of `fishmj gap`, and their shared parts."""
