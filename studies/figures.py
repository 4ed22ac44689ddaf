"""Every figure of the results pages that a command makes: `python -m studies.figures`.

    python -m studies.figures                from stored rows, and by commands below ten CPU minutes; exit 1 where a page differs
    python -m studies.figures --list         names, costs and commands
    python -m studies.figures NAME ..        these, at any cost
    python -m studies.figures --rows         from stored rows alone, seconds
    python -m studies.figures --write        the tables of studies/FIGURES.md

An entry of studies/figures.toml is one figure or one table:

    name, page, says, command    as studies/FIGURES.md lists it
    machine, minutes, cost       cpu, gpu or data (recordings that are not here); minutes of it; both in words
    place                        page on which the numbers stand, if it is another
    header, columns, rows        table of the page by the start of its header; its columns that `figure_rows.<rows>` remakes
    find, json, output           patterns whose groups are the page's numbers; where the command's last line has them, as
                                 `results.0.n` or `..value*100`, or patterns of its output
    run                          the command with its options for this, if they differ; without numbers: its exit code is 0
    tolerance                    largest difference, by default half of the last digit that the page shows

A range in place of a number, `0.65 to 0.69`, is two numbers. What is not run is printed with its command.
"""

import json
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import write_text
from studies import figure_rows

ROOT = Path(__file__).resolve().parent.parent
ENTRIES = ROOT / "studies" / "figures.toml"
PAGE = ROOT / "studies" / "FIGURES.md"
BEGIN, END = "<!-- python -m studies.figures --write -->", "<!-- end -->"
NUMBER = re.compile(r"(?<![\w.])(?<!\w[-+])[-+]?(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?:e-?\d+)?")
CHEAP = 10.0  # CPU minutes that a command may take by default


class FigureEntry(NamedTuple):
    """An entry of figures.toml; the docstring of the module has the keys."""

    name: str
    page: str
    says: str
    command: str
    machine: str = "cpu"
    minutes: float = float("inf")
    cost: str = "-"
    place: str = ""
    header: str = ""
    columns: tuple[int, ...] = ()
    rows: str = ""
    find: tuple[str, ...] = ()
    json: tuple[str, ...] = ()
    output: tuple[str, ...] = ()
    run: str = ""
    tolerance: float = 0.0

    @property
    def text(self) -> str:
        """Text of the page with the numbers."""
        return (ROOT / (self.place or self.page)).read_text(encoding="utf-8")

    @property
    def runs(self) -> bool:
        """Returns True if the command makes numbers, or an exit code, that can be compared."""
        return bool(self.json or self.output or self.run)


class ComparedNumber(NamedTuple):
    """A number on a page and the one that was made again; what: row of its table, or the pattern's place."""

    what: str
    on_page: str
    made: float
    tolerance: float

    @property
    def same(self) -> bool:
        """Returns True if the two differ by no more than the tolerance."""
        return abs(number(self.on_page) - self.made) <= self.tolerance


def entries() -> list[FigureEntry]:
    """Entries of figures.toml in their order. Raises ConfigError for an unknown key or a name that is there twice."""
    listed = tomllib.loads(ENTRIES.read_text(encoding="utf-8"))["figure"]
    found = []
    for row in listed:
        if unknown := set(row) - set(FigureEntry._fields):
            raise ConfigError(f"{ENTRIES.name}: {row.get('name')}: unknown keys {', '.join(sorted(unknown))}")
        given: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}
        found.append(FigureEntry(**given))
    names = [entry.name for entry in found]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ConfigError(f"{ENTRIES.name}: {', '.join(sorted(twice))}: there twice")
    return found


def number(text: str) -> float:
    """Number as a page writes it, `108,000`."""
    return float(text.replace(",", ""))


def rounding(text: str) -> float:
    """Half of the last digit of a number as a page writes it, and a little more."""
    mantissa, _, power = text.replace(",", "").partition("e")
    return 0.51 * 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))


def plain(cell: str) -> str:
    """Cell of a table without Markdown's marks."""
    return re.sub(r"[`*]", "", cell).strip()


def table_rows(text: str, header: str) -> list[list[str]]:
    """Cells of the rows of the first table whose header begins so. Raises ConfigError: no such table."""
    lines = text.splitlines()
    first = next((i for i, line in enumerate(lines) if line.startswith(header)), None)
    if first is None:
        raise ConfigError(f"figures: no table that begins with {header!r}")
    found = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        found.append([plain(cell) for cell in line.strip("|").split("|")])
    return found


def from_rows(entry: FigureEntry) -> list[ComparedNumber]:
    """Numbers of a table of the page beside those from stored rows."""
    text, remake = entry.text, getattr(figure_rows, entry.rows)
    if not entry.header:
        return paired(entry.name, [one for pattern in entry.find for one in groups(pattern, text, entry.page)], remake(""), None)
    found: list[ComparedNumber] = []
    for cells in table_rows(text, entry.header):
        shown = [one for k in entry.columns for one in NUMBER.findall(cells[k])]
        found += paired(f"{entry.name}: {cells[0]}", shown, remake(cells[0]), None)
    return found


def by_command(entry: FigureEntry) -> list[ComparedNumber]:
    """Numbers of the page beside those that the command makes now."""
    shown = [group for pattern in entry.find for group in groups(pattern, entry.text, entry.place or entry.page)]
    words = shlex.split(entry.run or entry.command)
    words = [sys.executable, "-m", *words] if words[0] == "fishmj" else [sys.executable, *words[1:]]
    done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if not (entry.json or entry.output):
        return [ComparedNumber("exit code", "0", done.returncode, 0.0)]
    if entry.json:
        last = done.stdout.strip().splitlines()[-1:] or [""]
        try:
            answer = json.loads(last[0])
        except ValueError as error:
            raise ConfigError(f"{entry.name}: exit {done.returncode}, and its last line is no JSON: {last[0][:120]}") from error
        made = [at(answer, path) for path in entry.json]
    else:
        made = [number(group) for pattern in entry.output for group in groups(pattern, done.stdout, "its output")]
    return paired(entry.name, shown, made, entry.tolerance)


def groups(pattern: str, text: str, where: str) -> list[str]:
    """Groups of the first match. Raises ConfigError: no match."""
    match = re.search(pattern, text)
    if match is None:
        raise ConfigError(f"figures: {where} has nothing like {pattern}")
    return list(match.groups())


def at(answer: Any, path: str) -> float:
    """Number at a path of a JSON value, `results.0.overall.arrival.value*72`."""
    keys, _, factor = path.partition("*")
    for key in keys.split("."):
        answer = answer[int(key) if isinstance(answer, list) else key]
    return float(answer) * float(factor or 1)


def paired(what: str, shown: Iterable[str], made: Iterable[float], tolerance: float | None) -> list[ComparedNumber]:
    """Numbers of the page with those made, in order. Raises ConfigError if there are not as many."""
    shown, made = list(shown), list(made)
    if len(shown) != len(made):
        raise ConfigError(f"{what}: the page has {len(shown)} numbers ({', '.join(shown)}), made were {len(made)}")
    return [ComparedNumber(what, text, value, tolerance or rounding(text)) for text, value in zip(shown, made, strict=True)]


def listing(some: list[FigureEntry]) -> str:
    """Tables of studies/FIGURES.md, one for each folder of pages."""
    parts = []
    for folder in dict.fromkeys(Path(entry.page).parent.name for entry in some):
        mine = [entry for entry in some if Path(entry.page).parent.name == folder]
        lines = [
            f"[{folder.capitalize()}](../docs/{folder}/{Path(mine[0].page).name}):",
            "",
            "| number | command | cost |",
            "|---|---|---|",
        ]
        lines += [f"| {e.says} | {f'`{e.command}`' if e.command else 'not recorded'} | {e.cost} |" for e in mine]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def on_page(text: str, made: str) -> str:
    """Text of the page with these tables between its two marks."""
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n\n{made}\n\n{END}{rest.partition(END)[2]}"


def check(entry: FigureEntry, run: bool) -> dict[str, Any]:
    """Result of one entry: state `same`, `DIFFERS`, `failed` or `not run`, how, and the numbers that differ."""
    row: dict[str, Any] = {
        "name": entry.name,
        "state": "not run",
        "by": entry.machine,
        "numbers": 0,
        "differ": [],
        "command": entry.command,
    }
    started = monotonic()
    try:
        compared = from_rows(entry) if entry.rows else []
        if run and entry.runs:
            compared += by_command(entry)
            row["seconds"] = round(monotonic() - started, 1)
    except (ConfigError, KeyError, StopIteration, IndexError, ValueError) as error:
        return row | {"state": "failed", "why": f"{type(error).__name__}: {error}"}
    if not compared:
        return row
    how = " and ".join(["stored rows"] * bool(entry.rows) + ["command"] * bool(run and entry.runs))
    differ = [one._asdict() for one in compared if not one.same]
    return row | {"state": "DIFFERS" if differ else "same", "by": how, "numbers": len(compared), "differ": differ}


def wanted(entries: list[FigureEntry], names: list[str], rows: bool) -> list[tuple[FigureEntry, bool]]:
    """Entries to look at, each with True if its command is to be run. Raises UnknownName: no such figure."""
    known = {entry.name: entry for entry in entries}
    for name in names:
        if name not in known:
            raise UnknownName("figure", name, known)
    if names:
        return [(known[name], not rows) for name in names]
    return [(entry, not rows and entry.machine == "cpu" and entry.minutes < CHEAP) for entry in entries]


def main(argv: list[str]) -> int:
    """Checks figures; returns the exit code."""
    parser = console.parser("figures", (__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="figures to check; default: all, commands below ten CPU minutes")
    parser.add_argument("--list", action="store_true", help="names, costs and commands, nothing is run")
    parser.add_argument("--rows", action="store_true", help="from stored rows alone")
    parser.add_argument("--write", action="store_true", help="write the tables of studies/FIGURES.md, nothing is run")
    args = parser.parse_args(argv)
    found = entries()
    if args.write:
        write_text(PAGE, on_page(PAGE.read_text(encoding="utf-8"), listing(found)))
        console.say(f"wrote {PAGE.relative_to(ROOT)}")
        return console.OK
    if args.list:
        shown = lambda e: "rows" if e.rows else "command" if e.runs else "by hand"
        console.say(
            console.table([{"name": e.name, "checked by": shown(e), "cost": e.cost, "command": e.command} for e in found])
        )
        return console.OK
    todo, rows = wanted(found, args.names, args.rows), []
    with console.Progress(len(todo), "figures") as bar:
        for k, (entry, run) in enumerate(todo):
            bar.stage(f"{entry.name}: {entry.cost}" if run and entry.runs else entry.name)
            rows.append(check(entry, run))
            bar.update(k + 1)
    done = [row for row in rows if row["state"] != "not run"]
    console.say(console.table([{key: row.get(key) for key in ("name", "state", "by", "numbers", "seconds")} for row in done]), "")
    for row in rows:
        console.say(*(f"{one['what']}: the page has {one['on_page']}, now {one['made']:.4g}" for one in row["differ"]))
        console.say(*([f"{row['name']}: {row['why']}"] if "why" in row else []))
    left = [row for row in rows if row["state"] == "not run"]
    console.say("", f"not run: {len(left)} of {len(rows)}", *(f"  {row['name']} ({row['by']}): {row['command']}" for row in left))
    if args.json:
        console.emit_json({"figures": rows})
    return console.OK if all(row["state"] in ("same", "not run") for row in rows) else console.FAILED_CHECK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
