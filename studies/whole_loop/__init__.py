"""A fault is hidden in a robot, and its user does all steps: measure, search, patch, train, swim. Counts the successes."""
