"""The water for training: force terms, planar chain, model parameters, injection into MuJoCo."""
