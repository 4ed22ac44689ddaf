"""The control loop of a real robot: clock, supervisor, arming, pilot, journal."""
