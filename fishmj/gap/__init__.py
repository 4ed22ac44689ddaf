"""Find where simulation and measurement disagree, name the missing effect, add it, show the gap shrink.

    workflow.investigate(model, trials).verdict

Rooms, in the order in which they build on each other (tests/test_architecture.py reads this table: imports go down it only):

    0   laboratory                     independent robots that make blind test data
    1   wording, progress, thresholds  names and numbers in words; progress; every deciding constant, from data/calib/gap.toml
    1   records                        measurements as a residual on one layout
    2   verdict, models                the five answers as data; the questioned models
    3   null                           the residual of a healthy robot
    4   search, localise               forward stepwise selection on cross-validated likelihood; place of the residual, in words
    5   decide, terms                  the gates of a verdict, rivals, intervals; forces as typed terms, if no effect explains it
    6   experiment                     the experiment that separates the remaining explanations
    7   workflow                       from a data set to a verdict
    8   report                         the page, and all its figures as JSON
    9   commands                       the commands of `fishmj gap`
    10  calibrate, measured            servo, latency, slip, water and mass from logs; robots that others measured
    11  bench                          the blind benchmarks and their baselines
"""
