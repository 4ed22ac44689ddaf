"""How often the monitor of `fishmj.deploy` alarms without a reason, and how soon with one."""
