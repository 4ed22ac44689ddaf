"""The workflow on measured data: groups of records replace the null runs, because no simulator knows the healthy robot."""
