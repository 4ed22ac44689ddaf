"""Articulated robots whose logs a search must explain: drawn robots, effects to hide in them, and three generators of logs.

    mujoco      MuJoCo with edited attributes, at another time step and integrator than the model in question
    pinocchio   dynamics of Pinocchio, with friction laws and a time stepper of its own (extra `bench`)
    bam         the servo laws of BAM (Rhoban) in MuJoCo, with the constants that they identified

All logs are *synthetic*. Nothing here imports the search, its effects or its model of a robot.
"""
