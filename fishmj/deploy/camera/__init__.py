"""Cameras and the poses from their pictures."""
