"""Trials for other programs: MCAP for Foxglove, Parquet for data frames, CSV for everything else.

    export("runs/trial_07", "mcap", "trial_07.mcap")     one file
    export("data/calm", "parquet", "calm_parquet")       one folder a trial; of MCAP, one file a trial

Numbers and stamps are exported unchanged: nothing is resampled. The output appears in one step, all of it or nothing.
"""

import heapq
import json
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fishmj import __version__
from fishmj.base import names
from fishmj.base.errors import LogError, MissingExtra, StoreError
from fishmj.base.store import put_in_place, temporary_beside, write_text
from fishmj.base.store.manifest import MANIFEST, Manifest
from fishmj.log import foxglove, measurements, toml, trial_check
from fishmj.log.dataset import read_bundle, read_dataset
from fishmj.log.foxglove import Json, Solid
from fishmj.log.table_files import row_place
from fishmj.log.trial import SCHEMA, TABLES, Trial, stacked, table_spec, unit
from fishmj.log.trial_folder import META_FILE, read_trial, write_trial

FORMS = ("mcap", "csv", "parquet")
NEEDS = {"mcap": "mcap", "parquet": "pyarrow"}
MARK = ".fishmj-export"  # in a folder that an export wrote: what --force may replace
MAGIC = b"\x89MCAP"
METADATA = "fishmj.log"  # name of the metadata record in an MCAP file
Entry = tuple[int, int, str, Json]  # log time ns, row, topic, message
Shape = Callable[[Trial], tuple[Solid, ...]]
Done = Callable[[float, int], None]
OFTEN = 5000  # messages between two reports of progress


def export(
    source: "str | Path",
    to: str,
    out: "str | Path",
    *,
    tables: Iterable[str] | None = None,
    force: bool = False,
    shape: Shape = lambda trial: (),
    done: Done = lambda count, total: None,
) -> list[dict]:
    """Writes a trial, a data set or a bundle in another form.

    Args:
        to: "mcap", "csv" or "parquet". out: for one trial the file (mcap) or the folder; for a data set the folder.
        tables: only these; all by default. force: replace what an export wrote before.
        shape: the links of a trial's robot as they are drawn, () where it is not known; mcap only.
        done: called with the number of trials written so far, parts of one included, and of all.

    Returns:
        One row a trial: trial, path, tables, rows, bytes, absent (tables asked for that it lacks).

    Raises:
        LogError: no such trial, none of the tables, a name that cannot stand in a path. UnknownName: no such table.
        MissingExtra: mcap or pyarrow is not installed. StoreError: `out` exists, or the disk refuses.
    """
    source, out, wanted = Path(source), Path(out), _wanted(tables)
    if to not in FORMS:
        raise LogError(f"export: form {to!r}; expected one of {', '.join(FORMS)}")
    if to in NEEDS and find_spec(NEEDS[to]) is None:
        raise MissingExtra(NEEDS[to], "logs", f"log export --to {to}")
    many = _is_many(source)
    check_place(source, out, folder=many or to != "mcap", force=force)
    temporary = temporary_beside(out)
    try:
        if not many:
            trial = read_trial(source)
            temporary.parent.mkdir(parents=True, exist_ok=True)
            rows = [_one(trial, to, temporary, wanted, shape, lambda part: done(part, 1))]
            done(1, 1)
        else:
            trials, total, meta = _many(source)
            temporary.mkdir(parents=True)
            rows = []
            for trial in trials:
                path = temporary / (f"{trial.name}.mcap" if to == "mcap" else trial.name)
                path.parent.mkdir(parents=True, exist_ok=True)
                rows.append(_one(trial, to, path, wanted, shape, lambda part: done(len(rows) + part, total)))  # noqa: B023
                done(len(rows), total)
            if source.is_dir() and (page := measurements.read(source)):
                measurements.write(temporary, page)
            Manifest.of(temporary, meta).write(temporary)
        if temporary.is_dir():
            write_text(temporary / MARK, "written by fishmj log export; --force replaces this folder\n")
        put_in_place(temporary, out)
    except OSError as error:
        raise error if isinstance(error, StoreError) else StoreError(f"{out}: could not be written: {error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return [{**row, "path": str(out / Path(row["path"]).relative_to(temporary))} for row in rows]


def check_place(source: Path, out: Path, *, folder: bool, force: bool) -> None:
    """Raises StoreError if `out` must not be written: it exists, is no export of ours, or holds the source."""
    here, there = source.resolve(), out.resolve()
    if here == there or there in here.parents or here in there.parents:
        raise StoreError(f"{out}: lies in, or holds, what is exported ({source}); choose another place")
    if not out.exists():
        return
    if not force:
        raise StoreError(f"{out}: exists; choose another name, or pass --force to replace it")
    if folder != out.is_dir():
        raise StoreError(f"{out}: is a {'file' if folder else 'folder'}, and a {'folder' if folder else 'file'} would replace it")
    if folder and not (out / MARK).is_file():
        raise StoreError(f"{out}: no export wrote it (no {MARK} in it); not replaced. Choose another place")
    if not folder and out.read_bytes()[: len(MAGIC)] != MAGIC:
        raise StoreError(f"{out}: is no MCAP file; not replaced. Choose another place")


# -------------------------------------------------------------------------------------------------------------------- source
def _wanted(tables: Iterable[str] | None) -> tuple[str, ...]:
    asked = tuple(dict.fromkeys(TABLES if tables is None else tables))
    for name in asked:
        table_spec(name)
    if not asked:
        raise LogError(f"export: no table is asked for; expected some of {', '.join(TABLES)}")
    return asked


def _is_many(source: Path) -> bool:
    if source.suffix == ".npz" and source.is_file():
        return True
    return source.is_dir() and (source / MANIFEST).is_file() and not (source / META_FILE).is_file()


def _many(source: Path) -> tuple[Iterator[Trial], int, dict]:
    """Trials one at a time under names that can stand in a path, their number, and the manifest's meta data."""
    if source.suffix == ".npz":
        found = read_bundle(source)
        return (_named(trial, trial.name, source) for trial in found), len(found), {"source": source.name}
    data = read_dataset(source)
    return (_named(data[name], name, source) for name in data.names), len(data), data.meta


def _named(trial: Trial, name: str, source: Path) -> Trial:
    for part in name.split("/") or [""]:
        names.checked(part, "trial", str(source))
    return replace(trial, name=name)


def _one(trial: Trial, to: str, path: Path, wanted: tuple[str, ...], shape: Shape, tell: Callable[[float], None]) -> dict:
    """Writes one trial to `path` and returns its row of the summary; `tell` receives the finished fraction."""
    kept = {name: trial.tables[name] for name in trial.tables if name in wanted}
    absent = [] if wanted == tuple(TABLES) else [name for name in wanted if name not in trial.tables]
    if not kept:
        raise LogError(f"trial {trial.name}: has none of {', '.join(wanted)}; it has {', '.join(trial.tables)}")
    for name, table in kept.items():  # a bundle was not checked when it was read
        trial_check.check_table(name, table, row_place(f"{trial.name}/{name}"))
    one = replace(trial, tables=kept)
    if to == "mcap":
        _mcap(one, path, shape(trial), tell)
    elif to == "parquet":
        _parquet(one, path)
    else:
        write_trial(path, replace(one, tables={n: _plain_names(t) for n, t in kept.items()}), form="csv")
    rows = {name: len(table["t"]) for name, table in kept.items()}
    files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
    size = sum(p.stat().st_size for p in files)
    return {"trial": trial.name, "path": str(path), "tables": rows, "rows": sum(rows.values()), "bytes": size, "absent": absent}


def _plain_names(table: dict) -> dict:
    """Table with column names that no spreadsheet reads as a formula and no reader as two columns; ours need no change."""
    out: dict[str, Any] = {}
    for name, values in table.items():
        safe = re.sub(r"[^A-Za-z0-9_. /^\[\]()-]", "_", name)
        safe = f"_{safe}" if safe[:1] in tuple("=+-@") else safe
        while safe in out:
            safe += "_"
        out[safe] = values
    return out


def _meta_text(trial: Trial) -> str:
    return toml.dumps(toml.nested({"schema": SCHEMA, **trial.meta}))


# ------------------------------------------------------------------------------------------------------------------- parquet
def _parquet(trial: Trial, folder: Path) -> None:
    """Writes one file a table.

    Each field's metadata states its unit, the file's metadata its table. meta.toml lies beside them.
    """
    import pyarrow
    from pyarrow import parquet

    folder.mkdir(parents=True)
    for name, table in trial.tables.items():
        fields = [pyarrow.field(c, pyarrow.float64(), metadata={"unit": unit(name, c)}) for c in table]
        about = {"fishmj.schema": SCHEMA, "fishmj.table": name, "fishmj.about": TABLES[name].about}
        columns = [pyarrow.array(np.asarray(values, float)) for values in table.values()]
        parquet.write_table(pyarrow.table(columns, schema=pyarrow.schema(fields, metadata=about)), folder / f"{name}.parquet")
    write_text(folder / META_FILE, _meta_text(trial))


# ---------------------------------------------------------------------------------------------------------------------- mcap
def _mcap(trial: Trial, path: Path, solids: tuple[Solid, ...], tell: Callable[[float], None]) -> None:
    """Writes every table as its own topic, the topics of the 3D panel, and the meta data as attachment and as metadata record."""
    from mcap.writer import Writer

    text, zero = _meta_text(trial), min(0.0, trial.span[0])  # s: MCAP has no time before 0; the messages' own `t` stays
    rows = {name: len(table["t"]) for name, table in trial.tables.items()}
    total = sum(rows.values()) + sum(2 * rows.get(name, 0) for name in ("pose", "truth"))  # about: frames and poses beside them
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="", library=f"fishmj {__version__}")
        schemas = {
            name: writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            for name, schema in _schemas(trial).items()
        }
        channels: dict[str, int] = {}
        in_order = heapq.merge(*_streams(trial, solids, zero), key=lambda entry: entry[0])
        for count, (at, row, topic, message) in enumerate(in_order):
            if not count % OFTEN:
                tell(min(count / total, 1.0))
            if topic not in channels:
                schema = schemas.get(_KIND.get(topic, f"fishmj.{topic[1:]}"))
                channels[topic] = writer.register_channel(topic, "json", schema or 0)
            data = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
            writer.add_message(channels[topic], log_time=at, publish_time=at, data=data, sequence=row)
        first, _ = trial.span
        writer.add_attachment(_ns(first, zero), _ns(first, zero), META_FILE, "application/toml", text.encode())
        writer.add_metadata(METADATA, {"trial": trial.name, "start [s]": repr(zero), **_flat(trial.meta)})
        writer.finish()
        file.flush()
        os.fsync(file.fileno())


_KIND = {"/tf": "foxglove.FrameTransform", "/tf_links": "foxglove.FrameTransforms"}  # topic -> schema
_KIND |= dict.fromkeys(("/pose_in_tank", "/truth_in_tank"), "foxglove.PoseInFrame")
_KIND |= dict.fromkeys(("/scene_fish", "/scene_target"), "foxglove.SceneUpdate")


def _schemas(trial: Trial) -> dict[str, Json]:
    """Foxglove's own schemas, and one a table with the unit of every column in its description."""
    out = dict(foxglove.SCHEMAS)
    for name, table in trial.tables.items():
        columns = {c: {"type": "number", "description": f"[{u}]" if (u := unit(name, c)) else ""} for c in table}
        about = {"title": f"fishmj.{name}", "description": TABLES[name].about, "type": "object"}
        out[f"fishmj.{name}"] = {**about, "properties": columns, "required": list(columns)}
    return out


def _streams(trial: Trial, solids: tuple[Solid, ...], zero: float) -> list[Iterator[Entry]]:
    """Streams of messages for the file, each in the order of its stamps."""
    tables, out = trial.tables, [_rows(name, table, zero) for name, table in trial.tables.items()]
    seen = next((tables[name] for name in ("pose", "truth") if name in tables), None)
    for name in ("pose", "truth"):
        if name in tables:
            out.append(_drawn(f"/{name}_in_tank", tables[name], "x y yaw", zero, foxglove.pose))
    if seen is not None:
        tank, fish = foxglove.TANK, foxglove.FISH
        out.append(_drawn("/tf", seen, "x y yaw", zero, lambda at, *p: foxglove.frame(at, tank, fish, *p)))
        bends = next(((tables[n], c) for n, c in (("joint", "j#"), ("truth", "j#"), ("cmd", "c#")) if n in tables), None)
        angles = None if bends is None else stacked(*bends)
        fits = angles is not None and angles.shape[1] == len(solids) - 1
        first = _ns(min(float(seen["t"][0]), *([float(bends[0]["t"][0])] if bends else [])), zero) if fits else 0
        first = first if fits else _ns(float(seen["t"][0]), zero)
        out.append(iter([(first, 0, "/scene_fish", foxglove.body(first, solids if fits else ()))]))
        if fits and bends is not None and angles is not None:
            out.append(_bent(bends[0]["t"], angles, solids, zero))
    if (still := trial.value("target")) is not None and "target" not in tables and seen is not None:
        at = np.asarray(still, dtype=object).ravel()
        if len(at) >= 2 and all(isinstance(v, int | float) for v in at[:2]):
            first = _ns(float(seen["t"][0]), zero)
            out.append(iter([(first, 0, "/scene_target", foxglove.target(first, float(at[0]), float(at[1])))]))
    if "target" in tables:
        out.append(_drawn("/scene_target", tables["target"], "x y", zero, foxglove.target))
    return out


def _rows(name: str, table: dict, zero: float) -> Iterator[Entry]:
    columns, values = list(table), np.stack([np.asarray(v, float) for v in table.values()], 1)
    for row, line in enumerate(values.tolist()):
        message = dict(zip(columns, line, strict=True))
        yield _ns(message["t"], zero), row, f"/{name}", message


def _drawn(topic: str, table: dict, columns: str, zero: float, made: Callable[..., Json]) -> Iterator[Entry]:
    """Messages that `made` builds from the values of some columns (names with blanks between), row by row."""
    values = (np.asarray(table[c], float).tolist() for c in columns.split())
    for row, (t, *rest) in enumerate(zip(np.asarray(table["t"], float).tolist(), *values, strict=True)):
        at = _ns(t, zero)
        yield at, row, topic, made(at, *rest)


def _bent(stamps, angles: np.ndarray, solids: tuple[Solid, ...], zero: float) -> Iterator[Entry]:
    for row, (t, bend) in enumerate(zip(np.asarray(stamps, float).tolist(), angles.tolist(), strict=True)):
        at = _ns(t, zero)
        yield at, row, "/tf_links", foxglove.links(at, solids, bend)


def _ns(t: float, zero: float) -> int:
    return round((t - zero) * 1e9)


def _flat(meta: dict, before: str = "") -> dict[str, str]:
    """Meta data with dotted keys and text values, as a metadata record needs."""
    out: dict[str, str] = {}
    for key, value in meta.items():
        if isinstance(value, dict):
            out |= _flat(value, f"{before}{key}.")
        elif value is not None:
            out[f"{before}{key}"] = value if isinstance(value, str) else str(value)
    return out
