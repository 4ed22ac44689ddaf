"""The trial folder: one log schema for simulators, evaluator, robot and data sets. See docs/search/logs.md."""

from fishmj.log.dataset import Dataset, read_dataset, write_dataset
from fishmj.log.trial import SCHEMA, TABLES, Table, TableSpec, Trial, gaps, numbered, segments, stacked
from fishmj.log.trial_folder import read_trial, write_trial

__all__ = [
    "SCHEMA",
    "TABLES",
    "Dataset",
    "Table",
    "TableSpec",
    "Trial",
    "gaps",
    "numbered",
    "read_dataset",
    "read_trial",
    "segments",
    "stacked",
    "write_dataset",
    "write_trial",
]
