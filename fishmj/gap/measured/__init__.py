"""The workflow on measured data, where no simulator can say what nothing missing would look like: groups of records stand in."""
