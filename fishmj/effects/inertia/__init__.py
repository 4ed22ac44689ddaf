"""Effects of the stage `inertia`, one file each."""
