"""Accuracy of the camera trackers on a drawn fish: errors, share of fixes, frames a second, false locks.

python -m studies.tracker --help
"""
