"""Series of station-holding trials on the robot, and their tables."""
