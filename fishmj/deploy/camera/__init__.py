"""Cameras and the pose that they give."""
