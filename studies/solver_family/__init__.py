"""The flow solver as a family of robots of the benchmark: healthy robots, free swims to calibrate by, and hidden effects."""
