"""A fault is hidden in a robot, and its user goes the whole way: measure, search, patch, train, swim. How often does it help?"""
