"""From recorded movements to a water model: linear coefficients first, then the factors for speed and turning, then the residual.

regression_rows     movement of the links in every tick, and the force on them
linear_regression   coefficients by least squares, with a prior       identifiability   coefficients that the data determine
rollout             free swims of a whole batch                       gauss_newton      coefficients by these swims
force_training, rollout_training   the residual, by ticks and by swims         pipeline   all of it, resumable
"""
