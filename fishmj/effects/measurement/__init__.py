"""Effects of the stage `measurement`, one file each."""
