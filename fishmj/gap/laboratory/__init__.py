"""Blind robots, independent simulators whose logs hide an effect, and the laboratory around them, to test the search on.

    virtual_robot, generators, hidden_lbm    the robots: bodies, servos, water, sensors; each room with equations of its own
    session, weighing_readings               what is done with a robot: trials and their meta data, weighings
    instruments, random_streams              encoders, order of arrival, noise of each channel and the numbers it is drawn from
    effect_text, numba_entry                 how an effect is asked for; how a water is compiled

The files directly here know none of the robots.
"""
