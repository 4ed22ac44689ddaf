"""Evidence: benchmarks, ablations and whole-chain trials that no command starts. The package never imports it."""
