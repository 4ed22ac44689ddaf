"""Effects of the stage `timing`, one file each."""
