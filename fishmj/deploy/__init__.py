"""The robot's host: camera, radio or servo bus, a policy at 5 Hz on a 50 Hz bus, and a supervisor that fails safe.

It runs with the packages of `host_requirements.txt` and nothing else; see docs/tank/deploy.md.
"""
