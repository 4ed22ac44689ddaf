"""From recorded movements to a water model: what is linear first, then what decides speed and turning, then the residual.

regression_rows     what the links did in every tick, and the force on them
linear_regression   coefficients by least squares, with a prior       identifiability   which of them the data tell apart
rollout             free swims of a whole batch                       gauss_newton      coefficients by these swims
force_training, rollout_training   the residual, by ticks and by swims         pipeline   all of it, resumable
"""
