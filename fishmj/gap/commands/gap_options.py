"""Options that several commands of `fishmj gap` share, each with its range."""

from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import left_out
from fishmj.gap.null.null_runs import LAST_SEED, LOUDEST, MOST_RUNS, RUNS

MOST_EFFECTS = 8
FEWEST_RUNS = 8  # of every record: with fewer the scatter cannot be estimated


def of_null(add) -> None:
    """Adds --noise, --null-runs, --seed."""
    noise = f"factor on the sensors' usual noise, for logs that state no noise: 0 to {LOUDEST:g} (default 1)"
    add("--noise", type=console.number(0, LOUDEST), default=1.0, metavar="FACTOR", help=noise)
    runs = f"runs of every record in the independent simulator, {FEWEST_RUNS} to {MOST_RUNS} (default {RUNS});"
    runs += " with fewer than 64, a healthy fish may show a gap"
    add("--null-runs", type=console.whole(FEWEST_RUNS, MOST_RUNS), default=RUNS, metavar="N", help=runs)
    of_seed(add, "of the split and of the null runs")


def of_mass(add) -> None:
    """Adds --mass-unknown."""
    text = "the robot was never weighed, so its mass may differ from the model's (default: without scales in measurements.toml"
    add("--mass-unknown", action="store_true", help=f"{text} the model's mass counts as weighed, to 0.1 %%)")


def of_robot(add) -> None:
    """Adds --same-robot."""
    add("--same-robot", action="store_true", help="accept logs that state another robot or body as the model's own")


def of_columns(add) -> None:
    """Adds --columns and --yes, of a robot in MJCF."""
    columns = "map of the logs' columns, for a robot in MJCF (default: guessed from their names)"
    add("--columns", type=console.path, metavar="MAP.toml", help=columns)
    add("--yes", action="store_true", help="accept the guessed columns without asking")


def of_written_map(add) -> None:
    """Adds --write-map, of a robot in MJCF."""
    written = "only write the guessed columns as a map for --columns, for a robot in MJCF (default: search)"
    add("--write-map", type=console.out_file, metavar="MAP.toml", help=written)


def of_seed(add, what: str) -> None:
    """Adds --seed."""
    add("--seed", type=console.whole(0, LAST_SEED), default=0, metavar="N", help=f"{what}, from 0 (default 0)")


def there(*paths: Path | None) -> None:
    """Checks that the inputs exist before anything is loaded; None: not given. Raises ConfigError."""
    for path in paths:
        if path is not None and not path.exists():
            raise ConfigError(f"{str(path)[:80]}: no such file or folder{left_out(path)}")
