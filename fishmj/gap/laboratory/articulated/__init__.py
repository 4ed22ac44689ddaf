"""Articulated test robots: random robots, effects to hide in them, and three generators of logs.

    mujoco      MuJoCo with edited attributes, with another time step and integrator than the described model
    pinocchio   dynamics of Pinocchio, with friction laws and a time stepper of its own (extra `bench`)
    bam         the servo laws of BAM (Rhoban) in MuJoCo, with their identified constants

All logs are *synthetic*. Nothing here imports the search, its effects or its model of a robot.
"""
