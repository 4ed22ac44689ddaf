"""What is made of a guess: a map, comments on what the map leaves out, and the choices that are left to the user."""

from collections.abc import Iterable, Iterator, Sequence

from fishmj.errors import LogError
from fishmj.log.importers.column_map import ColumnMap, measured, of_dict
from fishmj.log.importers.column_units import likely
from fishmj.log.importers.guess import LEFT, NANOSECONDS, TAKEN, UNCLEAR, FileKind, Guess
from fishmj.log.limits import quoted


def unclear(guesses: Iterable[Guess]) -> list[Guess]:
    """Those that the user must decide."""
    return [g for g in guesses if g.state == UNCLEAR]


def map_of(guesses: Sequence[Guess], found: Sequence[FileKind], meta: dict, where: str) -> ColumnMap:
    """The map that the guesses make, unclear ones left out.

    Raises:
        LogError: nothing is left.
    """
    tables: dict[str, dict] = {}
    for k in range(len(found)):
        mine = [g for g in guesses if g.kind == k and g.state == TAKEN]
        stamp = next((g for g in mine if g.place == "t"), None)
        if stamp is None:
            continue
        t = (
            {"column": stamp.column}
            | ({"unit": stamp.unit} if stamp.unit else {})
            | ({"scale": stamp.scale} if stamp.scale != 1 else {})
        )
        for g in mine:
            if g is stamp:
                continue
            if g.place == NANOSECONDS:
                t["nanoseconds"] = g.column
                continue
            table, _, column = g.place.partition(".")
            entry = tables.setdefault(table, {"t": t, "columns": {}, "kind": k})
            source = {"column": g.column} | ({"unit": g.unit} if g.unit else {}) | ({"scale": g.scale} if g.scale != 1 else {})
            entry["columns"][column] = source
    for entry in tables.values():
        k = entry.pop("kind")
        used = {entry["t"]["column"], *(c["column"] for c in entry["columns"].values())}
        if any(used <= set(other.columns) for i, other in enumerate(found) if i != k) and found[k].pattern:
            entry["file"] = found[k].pattern
    if not tables:
        raise LogError(_nothing(guesses, where))
    return of_dict({"tables": tables, "meta": meta, "skip": [g.column for g in guesses if g.said and not g.places]}, where)


def _nothing(guesses: Sequence[Guess], where: str) -> str:
    if all(g.place != "t" for g in guesses):
        names = ", ".join(quoted(g.column)[1:-1] for g in guesses[:8])
        return (
            f'{where}: no column of time among {names}; say which with --set "NAME=t:ms", or in a map t = '
            f'{{ column = "frame", scale = 0.01 }}'
        )
    told = "; ".join(f"{quoted(g.column)[1:-1]}: {g.why}" for g in guesses if g.place != "t")[:300]
    return f"{where}: no column was recognised ({told}); write a map (docs/logs.md) and import with --columns MAP.toml"


def choices(g: Guess) -> str:
    """What --set could say of an unclear column."""
    table, _, column = g.place.partition(".")
    what = "time" if g.place == "t" else measured(table, column)
    units = g.fits or ([g.unit] if g.unit else likely(what))
    options = [f"{place}:{unit}" if unit else place for place in g.places for unit in units or [""]]
    return " or ".join(f"{o}*SCALE" if o.endswith(":px") else o for o in options)


def remarks(found: Sequence[FileKind], guesses: Iterable[Guess]) -> Iterator[str]:
    """Comments of a map: every column of the files that no line of it takes."""
    for g in guesses:
        name = f"{quoted(found[g.kind].sheets[0].name)[1:-1]}: {quoted(g.column)[1:-1]}"
        if g.state == UNCLEAR:
            yield f"# unclear: {name} may be {choices(g)} ({g.why})\n"
        elif g.state == LEFT and not g.said:
            yield f"# left out: {name} ({g.why})\n"
