"""What was measured: records, their residual, whether they are enough, and what was weighed."""
