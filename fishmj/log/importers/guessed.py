"""Uses of a guess: a map, comments on the omitted columns, a table for the terminal, and the choices left to the user."""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import LogError
from fishmj.log import toml
from fishmj.log.importers.column_guess import LEFT, TAKEN, UNCLEAR, FileKind, Guess
from fishmj.log.importers.column_map import HEAD, ColumnMap, measured, of_dict
from fishmj.log.importers.column_units import likely
from fishmj.log.importers.sheet import DATE
from fishmj.log.limits import bare, kinds_first, typed
from fishmj.log.trial_folder import OF_ARM

Guesses = list[tuple[Sequence[FileKind], list[Guess]]]  # one for each layout of files
SHOWN = 3  # first values of a column


def unclear(guesses: Iterable[Guess]) -> list[Guess]:
    """Guesses that the user must decide."""
    return [g for g in guesses if g.state == UNCLEAR]


def map_of(guesses: Sequence[Guess], found: Sequence[FileKind], meta: dict, where: str) -> ColumnMap:
    """Map from the guesses, without unclear ones. Raises LogError: nothing is left."""
    tables: dict[str, dict] = {}
    for k in range(len(found)):
        mine = [g for g in guesses if g.kind == k and g.state == TAKEN]
        stamp = next((g for g in mine if g.place == "t"), None)
        if stamp is None:
            continue
        t = _source(stamp)
        for g in mine:
            if g is stamp:
                continue
            if g.table == "t":
                t[g.place.removeprefix("t.")] = g.column
                continue
            table, _, column = g.place.partition(".")
            entry = tables.setdefault(table, {"t": t, "columns": {}, "kind": k})
            entry["columns"][column] = _source(g)
    for entry in tables.values():
        k = entry.pop("kind")
        used = {entry["t"]["column"], *(c["column"] for c in entry["columns"].values())}
        if any(used <= set(other.columns) for i, other in enumerate(found) if i != k) and found[k].pattern:
            entry["file"] = found[k].pattern
    if not tables:
        raise LogError(_nothing(guesses, where))
    return of_dict({"tables": tables, "meta": meta, "skip": [g.column for g in guesses if g.said and not g.places]}, where)


def _source(g: Guess) -> dict:
    """A column in the notation of the map."""
    return {"column": g.column} | ({"unit": g.unit} if g.unit else {}) | ({"scale": g.scale} if g.scale != 1 else {})


def _nothing(guesses: Sequence[Guess], where: str) -> str:
    if all(g.place != "t" for g in guesses):
        names = ", ".join(bare(g.column) for g in guesses[:8])
        return (
            f'{where}: no column of time among {names}; say which with --set "NAME=t:ms", or in a map t = '
            f'{{ column = "frame", scale = 0.01 }}'
        )
    text = "; ".join(f"{bare(g.column)}: {g.why}" for g in guesses if g.place != "t")[:300]
    todo = "write a map (docs/search/logs.md) and import with --columns MAP.toml"
    return f"{where}: no column was recognised ({text}); {OF_ARM}; otherwise {todo}"


def choices(g: Guess) -> str:
    """Values of --set for an unclear column."""
    if g.fits == ("skip",):
        return "skip"
    table, _, column = g.place.partition(".")
    what = "time" if g.place == "t" else measured(table, column)
    units = g.fits or ([g.unit] if g.unit else likely(what))
    options = [f"{place}:{unit}" if unit else place for place in g.places for unit in units or [""]]
    return " or ".join(f"{o}*SCALE" if o.endswith(":px") else o for o in options)


def remarks(found: Sequence[FileKind], guesses: Iterable[Guess]) -> Iterator[str]:
    """Comments for a map: every column of the files that the map does not use."""
    for g in guesses:
        name = f"{bare(found[g.kind].sheets[0].name)}: {bare(g.column)}"
        if g.state == UNCLEAR:
            may = choices(g)
            yield f"# unclear: {name} may be {may} ({g.why})\n"
            if g.table != "t" and may != "skip":
                column = g.place.partition(".")[2]
                yield f"#          in [tables.{g.table}]: columns.{column} = {_open_source(g, may)}\n"
        elif g.state == LEFT and not g.said:
            yield f"# left out: {name} ({g.why})\n"


def to_complete(found: Sequence[FileKind], guesses: Sequence[Guess]) -> Iterator[str]:
    """Lines of a map of which no table is known yet: its blocks are comments, with what is known filled in."""
    yield f"{HEAD}# No column is clear: complete each ?, and remove the # in front of table, t and columns.\n"
    if skip := [g.column for g in guesses if g.said and not g.places]:
        yield f"skip = {toml.inline(skip)}\n"
    for k, kind in enumerate(found):
        here = [g for g in guesses if g.kind == k and not (g.said and not g.places)]
        stamps = [g for g in here if g.place == "t" and g.state != LEFT]
        blocks: dict[str, list[Guess]] = {}
        for g in here:
            if g.state != LEFT and g.table != "t":
                blocks.setdefault(g.table, []).append(g)
        for table, mine in (blocks or {"?": [g for g in here if g not in stamps]}).items():
            yield f"\n# [tables.{table}]    of {bare(kind.sheets[0].name)}\n"
            yield f"# file = {toml.inline(kind.pattern)}\n" if len(found) > 1 and kind.pattern else ""
            yield from (_to_complete("t", g) for g in stamps or [Guess(k, "?", why="the column of time")])
            yield from (_to_complete(f"columns.{g.place.partition('.')[2] or '?'}", g) for g in mine)
        yield from remarks(found, [g for g in here if g.state == LEFT] if blocks else ())


def _to_complete(key: str, g: Guess) -> str:
    """A column as a commented line of a map."""
    may = choices(g) if g.state == UNCLEAR else ""
    return f"# {key} = {_open_source(g, may)}    # {bare(f'{may} ({g.why})' if may else g.why, 300)}\n"


def _open_source(g: Guess, may: str) -> str:
    """A column in the notation of the map, with a ? for what is to be said. may: its `choices`, "" for one that is clear."""
    several = g.state == LEFT or len(may.split(" or ")) > len(g.places) > 0
    return toml.inline(_source(g) | ({"unit": "?"} if several else {}) | ({"scale": "?"} if "*" in may else {}))


def show(found: Guesses) -> None:
    """Prints every column, a table for each layout of files."""
    for kinds, made in found:
        rows = [_as_row(kinds, g) for g in made]
        console.say(console.table(rows, ["file", "column", "becomes", "unit", "first values", "why"]), "")


def rows(found: Guesses) -> list[dict]:
    """All columns as rows for JSON."""
    return [_as_row(kinds, g) for kinds, made in found for g in made]


def _as_row(kinds: Sequence[FileKind], g: Guess) -> dict:
    sheet = kinds[g.kind].sheets[0]
    values = sheet.columns[g.column]
    first = values[values == values][:SHOWN]
    becomes = f"UNCLEAR: {choices(g)}" if g.state == UNCLEAR else "left out" if g.state == LEFT else g.place
    more = f" (and {len(kinds[g.kind].sheets) - 1} more)" if len(kinds[g.kind].sheets) > 1 else ""
    unit = g.unit + (f"*{g.scale:g}" if g.scale != 1 else "")
    return {
        **{"file": bare(sheet.name) + more, "column": bare(g.column), "becomes": becomes},
        **{"unit": unit if g.state != LEFT else "", "first values": ", ".join(_shown(v, g.unit) for v in first), "why": g.why},
    }


def _shown(value: float, unit: str) -> str:
    if unit == DATE and abs(value) < 1e11:
        return f"{datetime.fromtimestamp(value, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3]
    return f"{value:.6g}"


def check_agreed(found: Guesses, source: Path, yes: bool) -> None:
    """Checks that nothing is unclear and that the user agrees, by `yes` or on the terminal.

    Raises LogError: a column is unclear, or the user does not agree.
    """
    doubts = [(f"{bare(kinds[g.kind].sheets[0].name)}: " * (len(kinds) > 1), g) for kinds, made in found for g in unclear(made)]
    if doubts:
        texts = kinds_first(f"{file}{bare(g.column)}: {g.why}, --set {typed(g.column)}={choices(g)}" for file, g in doubts)
        text = "; ".join(texts[:4]) + (f"; and {len(texts) - 4} more" if len(texts) > 4 else "")
        raise LogError(
            f"{source}: {len(doubts)} column(s) unclear: {text}; or COLUMN=skip; or --write-map "
            "MAP.toml, mend it, --columns MAP.toml"
        )
    if yes or all(_certain(g) for _, made in found for g in made):
        return
    if sys.stdin is None or not sys.stdin.isatty():
        raise LogError(
            f"{source}: the columns above are guessed; take them with --yes, or write them to a file with "
            "--write-map MAP.toml, mend it, and import with --columns MAP.toml"
        )
    console.say("Take these columns? [y/N]")
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise LogError(
            f"{source}: nothing imported; write the guess with --write-map MAP.toml, mend it, and import with --columns MAP.toml"
        )


def _certain(g: Guess) -> bool:
    """Returns True for a column without need of confirmation: stated by the user, or with the schema's name and unit."""
    own = g.place.rpartition(".")[2] == re.sub(r"\s*[\[(].*", "", g.column) and (
        not g.unit or g.unit in ("s", "rad", "m", "V", "A", "rad/s", "m/s")
    )
    return g.said or own
