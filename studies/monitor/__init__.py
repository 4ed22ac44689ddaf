"""False alarms of the monitor of `fishmj.deploy`, and its delay in finding a fault."""
