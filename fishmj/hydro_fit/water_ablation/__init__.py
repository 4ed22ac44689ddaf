"""What each part of the fitted water is worth."""
