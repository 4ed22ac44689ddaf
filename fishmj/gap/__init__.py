"""Find where simulation and measurement disagree, name the missing effect, add it, show the gap shrink.

    workflow.investigate(model, trials).verdict

Rooms, in the order in which they build on each other (tests/test_architecture.py reads this table: imports go down it only):

    0   laboratory                     independent robots that make blind test data
    1   wording, progress, thresholds  names and numbers in words; progress; every constant that decides, from data/calib/gap.toml
    1   records                        what was measured, as a residual on one layout
    2   verdict, models                the five answers as data; the models that are questioned
    3   null                           what a healthy robot leaves
    4   search, localise               forward stepwise selection on cross-validated likelihood; where the residual lies, in words
    5   decide, terms                  the gates of a verdict, rivals, intervals; forces as typed terms, where no effect explains
    6   experiment                     which experiment separates the explanations that are left
    7   workflow                       from a data set to a verdict
    8   report                         the page, and every figure on it as JSON
    9   commands                       the commands of `fishmj gap`
    10  calibrate, measured            servo, latency, slip, water and mass from logs; robots that others measured
    11  bench                         the blind benchmarks and their baselines
"""
