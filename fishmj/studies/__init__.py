"""Evidence: benchmarks, baselines, ablations, grid studies, other people's robots. Nothing outside imports it."""
