"""Decision for one of five answers: gates, rivals, secondary effects, intervals."""
