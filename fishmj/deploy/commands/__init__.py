"""Command lines of `fishmj deploy`, one file each."""
