"""From what was found to one of five answers: gates, rivals, secondary effects, intervals."""
