"""Effects of the stage `environment`, one file each."""
