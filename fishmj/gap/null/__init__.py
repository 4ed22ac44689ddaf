"""What a healthy robot leaves: simulated or recorded runs, and the whitening that they make."""
