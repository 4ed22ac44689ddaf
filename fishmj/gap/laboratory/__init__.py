"""Blind robots: independent simulators whose logs contain a hidden effect, as test data for the search.

    virtual_robot, generators, hidden_lbm    the robots: bodies, servos, water, sensors; each package has its own equations
    session, random_streams                  trials with their meta data; random streams
    instruments                              encoders, packet order, sensor noise; weighing tables
    effect_text, numba_entry                 notation of effects; compiler of the waters

These modules import none of the robots.
"""
