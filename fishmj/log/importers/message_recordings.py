"""Recordings of messages (MCAP, rosbag2) as tables, by a mapping of topics (`topics.py`) or by topics that are named like tables.

Any other recording is read by its columns (`message_sheets.py`). Nothing of a recording without a mapping is left out in silence.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.errors import FishmjError, LogError
from fishmj.log import toml
from fishmj.log.importers import guess, message_sheets, table_forms
from fishmj.log.importers.column_guess import LEFT
from fishmj.log.importers.column_map import is_column
from fishmj.log.importers.decoding import Found, TopicChannel, decoder, is_odd_stamp, names_in, own_stamp, read_json, sec_nanosec
from fishmj.log.importers.message_sheets import DAY, FOREIGN, ODD, UNSTAMPED, listed
from fishmj.log.importers.quaternion import heading
from fishmj.log.importers.registry import trial_of
from fishmj.log.importers.set_option import refuse_unknown
from fishmj.log.importers.topics import RECEIPT, UNITS, MessageField, Topic, Topics, by_name, table_of
from fishmj.log.limits import bare, quoted, typed
from fishmj.log.trial import Table, Trial, table_spec

ABSENT = object()  # the value of a joint that a message does not name
HEADER = "header.stamp"  # the clock of a topic that is named like a table and whose headers have stamps


@dataclass
class _Read:
    """One table: stamps and receipts [ns], message of each row, columns, clock, notes, and what tells robots apart."""

    stamps: list[int]
    receipts: list[int]
    at: list[int]
    columns: Table
    clock: str
    notes: list[str]
    apart: dict[str, str]
    labels: frozenset[str]  # fields that may tell robots apart

    @property
    def foreign(self) -> bool:
        """True if the stamps of its headers are on another clock than the receipts."""
        return self.clock == HEADER and abs(float(np.median(np.subtract(self.receipts, self.stamps)))) > DAY


def mapped(
    path: Path,
    found: Found,
    wanted: Topics | None,
    own: dict | None = None,
    notes: Sequence[str] = (),
    skip: Collection[str] = (),
) -> dict[str, Trial]:
    """Reads one trial, named after the file.

    Args:
        wanted: the mapping; by topics that are named like tables if None.
        own: meta data that the file carries as an export of ours: its stamps are on the trial's own clock.
        notes: remarks of the file's reader.
        skip: topics, and fields that tell robots apart, which the user leaves out, beside those of the mapping.

    Raises LogError: a topic, field or value does not match the mapping or `skip`, or a topic is left out that may hold data of a
    table; file:topic[message]:field.
    """
    wanted = wanted or named_like_tables(found, skip)
    if not wanted.tables:
        raise LogError(f"{path}: no topic is named like a table; it has {listed(found)}. Say which is which with --topics")
    skip, read = {*skip, *wanted.skip}, {}
    told = _left_out(path, found, wanted, skip) if own is None and wanted.named else []
    for name, entry in wanted.tables.items():
        if entry.topic not in found:
            raise LogError(f"{path}: no topic {entry.topic!r} for table {name!r}; it has {listed(found)}")
        read[name] = _columns(path, name, entry, found[entry.topic])
        used = {*skip, *(entry.columns or ())}
        several = next(((c, said) for c, said in read[name].apart.items() if c not in used), None)
        if own is None and several:
            at_top = f"skip = {toml.inline([several[0]])} at the top of the mapping of topics"
            say = f"--set {typed(several[0])}=skip" if wanted.named else at_top
            raise LogError(f"{path}:{entry.topic}: {several[1]}, or {say} to read them as one")
    if both := sorted(skip & {entry.topic for entry in wanted.tables.values()}):
        raise LogError(f"{path}: skip: {quoted(both[0])} is the topic of a table of the mapping; take it out of one of them")
    known = {*found, *chain(*(one.labels for one in read.values()))}
    refuse_unknown(path, skip, known, "topic, and no field that tells robots apart,")
    foreign = {name for name, one in read.items() if one.foreign}
    for name in sorted(foreign) if foreign < set(read) else ():
        told.append(f"{wanted.tables[name].topic}: {FOREIGN}")
        read[name] = replace(read[name], stamps=read[name].receipts, clock=RECEIPT)
    stamps = {name: one.stamps for name, one in read.items()}
    times, moved = _seconds(stamps) if own is None else ({name: np.array(ns, float) / 1e9 for name, ns in stamps.items()}, [])
    tables = {}
    for name, entry in wanted.tables.items():
        order, back = message_sheets.in_order(stamps[name])
        table = {"t": times[name][order], **{column: values[order] for column, values in read[name].columns.items()}}
        tables[name] = (table, _place(path, entry.topic, np.array(read[name].at)[order]))
        told += [*read[name].notes, *([f"{entry.topic}: {back}"] if back else [])]
    clocks = {name: one.clock for name, one in read.items()}
    meta = {"clock": clocks, "source": path.name, **wanted.meta} if own is None else own
    return {path.stem: trial_of(path.stem, meta, tables, [*notes, *moved, *told])}


def named_like_tables(found: Found, skip: Collection[str] = ()) -> Topics:
    """Mapping of JSON topics that are named like tables and whose first message has columns of that table."""
    return by_name({topic for topic, channel in found.items() if topic not in skip and _is_table(topic, channel)})


def _is_table(topic: str, channel: TopicChannel) -> bool:
    if channel.encoding != "json" or not channel.messages or not (name := table_of(topic)):
        return False
    return any(is_column(table_spec(name), key) for key in read_json(topic, channel.messages[0][2]))


def _left_out(path: Path, found: Found, wanted: Topics, skip: Collection[str]) -> list[str]:
    """A note for each topic that is not read beside those that are named like tables.

    Raises LogError: one of them may hold data of a table.
    """
    used = {entry.topic for entry in wanted.tables.values()}
    notes, needed = [], {}
    for topic in sorted(set(found) - used):
        if topic in skip:
            notes.append(f"{topic}: left out, as --set says")
            continue
        if _is_table(topic, found[topic]):
            needed[topic] = f"is named like table {table_of(topic)}, too"
            continue
        try:
            sheets, told = message_sheets.readable(path, {topic: found[topic]})
            made = guess.guess(guess.kinds(map(table_forms.looked_at, sheets)))
        except FishmjError as error:
            needed[topic] = f"cannot be read ({bare(error, 200)})"
            continue
        notes += told
        may = next((g for g in made if g.state != LEFT and g.table not in ("", "t")), None)
        if may is not None:
            needed[topic] = f"may hold {' or '.join(may.places[:2])} ({bare(may.column)})"
        elif sheets:
            names = ", ".join(bare(g.column) for g in made if g.place != "t")[:200]
            notes.append(f"{topic}: not read, beside topics that are named like tables: {names}")
    if needed:
        why = "; ".join(f"{topic} {what}" for topic, what in list(needed.items())[:4])
        raise LogError(
            f"{path}: only topics that are named like tables are read ({', '.join(sorted(used))}), but {why}: leave it out, "
            f"--set {typed(next(iter(needed)))}=skip; or read all by columns, --format table; or map topics, --topics MAP.toml"
        )
    return notes


def _place(path: Path, topic: str, at: np.ndarray):
    return lambda row, column: f"{path}:{topic}[{at[row] if 0 <= row < len(at) else 0}]:{column or 't'}"


def _numbers(
    path: Path, table: str, topic: str, channel: TopicChannel
) -> tuple[dict[str, MessageField], str | MessageField, list[str]]:
    """Fields that are numbers in each message of a topic without a mapping, the clock of its stamps, and notes on the others.

    Raises LogError: a column of the table is no number in some message.
    """
    decode, spec, n = decoder(path, topic, channel), table_spec(table), len(channel.messages)
    count, texts, bad, stamped, timed, odd = Counter[str](), set[str](), dict[str, tuple[int, Any]](), 0, False, 0
    for i in range(n):
        content = decode(i)
        stamped += bool(own_stamp(content))
        odd += is_odd_stamp(content)
        timed |= "t" in content
        texts |= table_forms.labels(content).keys()
        for key in {**count, **content}:
            known = isinstance(content.get(key), bool | int | float)
            count[key] += known
            if not known or count[key] <= i:  # or it was absent before
                bad.setdefault(key, (i, content.get(key)) if not known else (0, None))
    fields, lost = {key: MessageField((key,)) for key in count if key not in bad and key != "t"}, []
    for key, (at, got) in bad.items():
        if is_column(spec, key) or key in spec.fixed:
            raise LogError(
                f"{path}:{topic}[{at}]:{key} = {str(got)[:30]}; expected a finite number in each message, as in {count[key]} "
                f"of {n}. Leave the column out by a mapping of topics (--topics MAP.toml), or the messages by --format table"
            )
        lost += [key] if key not in texts and key not in ("header", "stamp") else []
    notes = [f"{topic}: {', '.join(map(quoted, lost))[:200]} left out: no number in each message"] if lost else []
    if timed:
        return fields, MessageField(("t",), "s"), notes
    if stamped == n:
        return {key: f for key, f in fields.items() if key != "stamp"}, HEADER, notes
    seen = {UNSTAMPED: n - stamped if stamped else 0, ODD: odd}
    notes += [f"{topic}: {why}, in {of} of {n} messages" for why, of in seen.items() if of]
    return fields, RECEIPT, notes


def _columns(path: Path, table: str, entry: Topic, channel: TopicChannel) -> _Read:
    """One table of a topic. A message that names only other joints is left out."""
    if not channel.messages:
        raise LogError(f"{path}: topic {entry.topic!r} has no message; leave its table out")
    decode = decoder(path, entry.topic, channel)
    fields, clock, notes = entry.columns, entry.clock or RECEIPT, []
    if fields is None:
        fields, own, notes = _numbers(path, table, entry.topic, channel)
        clock = entry.clock or own
    stamps, receipts, at, rows, joints, labels = [], [], [], [], {}, []
    for i, (log_time, publish_time, _) in enumerate(channel.messages):
        where, content = f"{path}:{entry.topic}[{i}]", decode(i)
        labels.append(table_forms.labels(content))
        found = [_dig(where, content, f) for f in fields.values()]
        if any(value is ABSENT for value, _ in found):
            continue
        for f, (_, joint) in zip(fields.values(), found, strict=True):
            if joints.setdefault(f, joint) != joint:
                raise LogError(
                    f"{where}: {f} is of joint {quoted(joint)}, in messages before it of {quoted(joints[f])}: the order of its "
                    f"names changes; name the joint in the mapping: {'.'.join((*f.path[:-1], joints[f] or joint))}"
                )
        if isinstance(clock, MessageField):
            stamps.append(_stamp(f"{where}:{clock}", clock, _dig(where, content, clock)[0]))
        else:
            stamps.append(own_stamp(content) or 0 if clock == HEADER else log_time if clock == RECEIPT else publish_time)
        receipts.append(log_time)
        at.append(i)
        rows.append([_number(f"{where}:{f}", value) * f.factor for f, (value, _) in zip(fields.values(), found, strict=True)])
    if not rows:
        names = ", ".join(map(quoted, names_in(decode(0)) or ()))
        raise LogError(f"{path}: no message of topic {entry.topic!r} names all joints of the mapping; the first has {names}")
    n = len(channel.messages)
    if len(rows) < n:
        notes.append(f"{entry.topic}: {n - len(rows)} of {n} messages left out: not all of its joints are named")
    values = np.array(rows, float).reshape(len(rows), len(fields)).T.copy()
    columns = dict(zip(fields, values, strict=True))
    apart = table_forms.told_apart(labels)
    return _Read(stamps, receipts, at, columns, str(clock), notes, apart, frozenset(chain(*labels)))


def _dig(where: str, content, wanted: MessageField) -> tuple[Any, str]:
    """Value at a path, and the joint that the message names for it; (ABSENT, joint) if the message lacks that joint.

    `position.tail_joint` is the value at the place of `tail_joint` in the message's own list of names.
    """
    value, names, joint = content, None, ""
    for k, part in enumerate(wanted.path):
        if isinstance(value, dict):
            names = names_in(value) or names
        if isinstance(value, dict) and part in value:
            value = value[part]
        elif isinstance(value, dict) and part == "yaw" and set(value) == set("xyzw"):
            value = _yaw(f"{where}:{wanted}", value)
        elif isinstance(value, list) and part.isdecimal() and len(part) < 9 and int(part) < len(value):
            joint = names[int(part)] if names and len(names) == len(value) else joint
            value = value[int(part)]
        elif isinstance(value, list) and names and not part.isdecimal():
            joint = ".".join(wanted.path[k:])  # a name may hold dots itself
            if joint not in names:
                return ABSENT, joint
            if len(value) != len(names) or names.count(joint) > 1:
                raise LogError(f"{where}: {len(value)} values for the names {', '.join(map(quoted, names))}; record it again")
            return value[names.index(joint)], joint
        else:
            has = ", ".join(map(str, value))[:200] if isinstance(value, dict) else type(value).__name__
            raise LogError(f"{where}: no field {str(wanted)!r}; at {part!r} there is {has}. Name the field in the mapping")
    return value, joint


def _yaw(where: str, value: dict) -> float:
    """Heading [rad] of one quaternion."""
    yaw, doubt = heading(np.array([[_number(f"{where}:{part}", value[part]) for part in "xyzw"]]), where)
    if doubt or not np.isfinite(yaw[0]):
        raise LogError(f"{where}: {doubt or 'the quaternion is 0, 0, 0, 0: it was not set'}; leave yaw out of the mapping")
    return float(yaw[0])


def _number(where: str, value) -> float:
    if not isinstance(value, bool | int | float) or not abs(value) < 1e300:
        raise LogError(f"{where} = {str(value)[:30]!r}; expected a finite number. Leave the message out")
    return float(value)


def _stamp(where: str, clock: MessageField, value) -> int:
    """Time of a field in ns: a number in the clock's unit (s by default), or an object {sec, nanosec}."""
    if isinstance(value, dict):
        if (whole := sec_nanosec(value)) is not None:
            return whole
        raise LogError(f"{where} = {str(value)[:60]}; expected {{sec, nanosec}} or a number")
    number = _number(where, value)
    scaled = value * 10**9 * UNITS[clock.unit] if clock.unit != "ns" else value
    if not abs(number) < 1e30:
        raise LogError(f"{where} = {str(value)[:30]!r}; expected a time in {clock.unit or 's'}")
    return round(scaled)


def _seconds(stamps: dict[str, list[int]]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Stamps in s after the earliest; a clock more than a day away from it gets its own zero, and a note."""
    first = {name: min(values) for name, values in stamps.items()}
    zero, notes = max(first.values()), []
    near = {name: start for name, start in first.items() if zero - start < DAY}
    zero = min(near.values())
    out = {}
    for name, values in stamps.items():
        own = zero if name in near else first[name]
        if name not in near:
            notes.append(f"{name}: its clock is {(zero - own) / 1e9:.0f} s away from the others; it starts at its own zero")
        out[name] = np.array([value - own for value in values], dtype=float) * 1e-9
    return out, notes
