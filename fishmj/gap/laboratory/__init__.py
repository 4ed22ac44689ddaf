"""Blind robots: independent simulators whose logs contain a hidden effect, as test data for the search.

    virtual_robot, generators, hidden_lbm    the robots: bodies, servos, water, sensors; each package has its own equations
    session, weighing_readings               trials with their meta data; weighing tables
    instruments, random_streams              encoders, packet order, sensor noise; random streams
    effect_text, numba_entry                 notation of effects; compiler of the waters

These modules import none of the robots.
"""
