"""From recorded movements to a water model: what is linear first, then what decides speed and turning, then the residual.

rows      what the links did over every tick, and the force on them
linear    coefficients by least squares, with a prior            identify   which of them the data tell apart
rollout   free swims of a whole batch                            newton     coefficients by what these swims show
learning  the residual, by one tick and by several               recipe     all of it, resumable
"""
