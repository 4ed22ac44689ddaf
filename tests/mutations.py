"""Documents with something wrong in them: what a fuzz test hands to a reader."""

import os
import random
import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any

VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**63, -(2**70), 0.5, -1e300, float("nan"), float("inf")),
    *("", "x", "../../x", "nan", "1", "a" * 5000, "\x00", "<script>", [], [[]], [1, "a"], {}, {"a": {"b": []}}, [None] * 3),
)


def places(document: Any, path: tuple = ()) -> Iterator[tuple]:
    """The path of every value in a nest of dictionaries and lists (of long lists the ends)."""
    inside: Any = ()
    if isinstance(document, dict):
        inside = document.items()
    elif isinstance(document, list):
        inside = [(i, document[i]) for i in sorted({0, 1, len(document) - 1}) if 0 <= i < len(document)]
    for key, value in inside:
        yield (*path, key)
        yield from places(value, (*path, key))


def mutated(document: Any, rng: random.Random) -> tuple[Any, str]:
    """A copy with one to three values replaced, removed, renamed or doubled, and what was done."""
    document, done = deepcopy(document), []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        where = list(places(document))
        if not where:
            break
        path = rng.choice(where)
        parent = document
        for key in path[:-1]:
            parent = parent[key]
        how = rng.choice(("replace", "replace", "replace", "remove", "rename", "double"))
        if how == "replace":
            value = deepcopy(rng.choice(VALUES))
            done.append(f"{path} = {str(value)[:30]!r}")
            parent[path[-1]] = value
        elif how == "remove":
            done.append(f"without {path}")
            del parent[path[-1]]
        elif isinstance(parent, dict):
            done.append(f"{how} {path}")
            parent[f"{path[-1]}x"] = parent.pop(path[-1]) if how == "rename" else deepcopy(parent[path[-1]])
        else:
            done.append(f"{how} {path}")
            parent.insert(path[-1], deepcopy(parent[path[-1]]))
    return document, "; ".join(done)


def seconds(least: float) -> float:
    """How long one fuzz test may take: FISHMJ_FUZZ_SECONDS, or `least`."""
    return float(os.environ.get("FISHMJ_FUZZ_SECONDS", least))


def first_seed() -> int:
    """Where the seeds of a fuzz test begin: FISHMJ_FUZZ_FIRST, or 0."""
    return int(os.environ.get("FISHMJ_FUZZ_FIRST", "0"))


def tell(name: str, count: int) -> None:
    """Add to the file FISHMJ_FUZZ_REPORT, if one is named, how many examples ran."""
    with open(os.environ.get("FISHMJ_FUZZ_REPORT", os.devnull), "a") as report:
        report.write(f"{name}: {count} examples\n")


def fuzz(read: Callable[[Any], Any], document: Any, allowed: type[Exception], count: int) -> None:
    """Call `read` with `count` mutations of `document`; any other exception than `allowed` fails with its recipe.

    With FISHMJ_FUZZ_SECONDS it goes on for that long.
    """
    seed = first_seed()
    rng, until, tried = random.Random(seed), time.monotonic() + seconds(0.0), 0
    while tried < count or time.monotonic() < until:
        broken, done = mutated(document, rng)
        tried += 1
        try:
            read(broken)
        except allowed:
            pass
        except Exception as error:
            raise AssertionError(f"mutation {tried} of seed {seed} ({done}): {type(error).__name__}: {error}") from error
    tell(os.environ.get("PYTEST_CURRENT_TEST", "fuzz").split(" ")[0], tried)
