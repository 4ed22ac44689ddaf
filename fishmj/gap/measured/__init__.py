"""Workflow on measured data: groups of records replace null runs, because no simulator represents the healthy robot."""
