"""Logs of the flow solver in which effects or numbers are hidden: another robot's servos and body in the solver's water."""
