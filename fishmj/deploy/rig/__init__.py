"""Experiments of a rig: prompts, captures, weighings, excitations."""
