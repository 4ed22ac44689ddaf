"""The water for training: fitted coefficients and a learnt residual, injected into MuJoCo and into the engines."""
