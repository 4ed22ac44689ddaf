"""Effects of the stage `actuator`, one file each."""
