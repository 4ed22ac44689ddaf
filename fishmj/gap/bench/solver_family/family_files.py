"""Names of the files in a folder of the solver's family."""

SWIMS, SETS, TRUTH = "swims", "sets", "truth.json"
FREE = "free"  # of the set that a robot is calibrated by
BARE = "-without_noise"  # of a trial's name
