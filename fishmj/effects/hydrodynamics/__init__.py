"""Effects of the stage `hydrodynamics`, one file each."""
