"""The commands of `fishmj gap`, and what they share."""
