"""Guesses a column map from names and values. A column with two possible readings is marked unclear and left to the user."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from glob import escape

import numpy as np

from fishmj.base.errors import LogError, UnknownName
from fishmj.log.importers import column_guess, column_units, header, table_forms
from fishmj.log.importers.column_guess import LEFT, TAKEN, UNCLEAR, FileKind, Guess, context
from fishmj.log.importers.column_map import measured
from fishmj.log.importers.column_units import PARTS, SI, UNITS, measures
from fishmj.log.importers.header import Role, role
from fishmj.log.importers.joint_names import STATE
from fishmj.log.importers.sheet import DATE, Sheet
from fishmj.log.limits import bare, quoted, typed
from fishmj.log.trial import table_spec

_NUMBER = re.compile(r"\d+")
COUNTED = ("rad*SCALE",)  # of a servo's ticks or pulses
FLAT = 5.0  # times that z moves further than y where y is the height


def flavour(sheet: Sheet) -> tuple:
    """Sorting key: sheets of one kind have the same columns and names of the same meaning."""
    said = context(sheet)
    topic = sheet.name if sheet.name != sheet.path.name else ""
    return tuple(sheet.columns), topic, bool(said & header.COMMAND), bool(said & header.MEASURED)


def kinds(sheets: Iterable[Sheet]) -> list[FileKind]:
    """Sheets sorted into kinds."""
    groups: dict[tuple, list[Sheet]] = {}
    for sheet in sheets:
        groups.setdefault(flavour(sheet), []).append(sheet)
    return [
        FileKind(tuple(group), _pattern(group, [s for g in groups.values() if g is not group for s in g]))
        for group in groups.values()
    ]


def _pattern(group: Sequence[Sheet], others: Sequence[Sheet]) -> str:
    """Pattern that the names of a group match and no other name does."""
    if len({sheet.name for sheet in group}) == 1:
        return escape(group[0].name)
    shared = set.intersection(*(set(context(sheet)) for sheet in group)) - set.union(set(), *(set(context(o)) for o in others))
    return f"*{max(shared, key=len)}*" if shared else ""


def guess(found: Sequence[FileKind], said: dict[str, tuple[str, str, float]] | None = None) -> list[Guess]:
    """One guess a column of every kind, in the order of the files.

    Args:
        said: column -> (place or "skip", unit, scale), by the user (`overrides`).
    """
    said = dict(said or {})
    out: list[Guess] = []
    for k, kind in enumerate(found):
        out += _roles(k, kind, said)
    if unknown := [name for name in said if not any(kind.called(name) for kind in found)]:
        raise UnknownName("column in --set", bare(unknown[0]), {bare(g.column) for g in out})
    out = _commanded_or_measured(column_guess.headings(column_guess.stamps(out, found)))
    out = [g for k, kind in enumerate(found) for g in _numbered([g for g in out if g.kind == k])]
    out = [g for k, kind in enumerate(found) for g in _units(kind, [g for g in out if g.kind == k])]
    out = _once(column_guess.off_centre(_points(_upright(out, found))), found)
    return _complete(column_guess.lost_commands(_nameless_joints(_counts(_silent(out, found)), found), found), found)


def _roles(k: int, kind: FileKind, said: dict) -> list[Guess]:
    out = []
    whole = next((said[sheet.name] for sheet in kind.sheets if sheet.name in said), None)
    if whole and whole[0] != "skip":
        raise LogError(
            f"--set {quoted(kind.sheets[0].name)}: is a file or topic, which can be left out with =skip; name a column"
        )
    for column in kind.columns:
        name = header.parse(column_guess.without_letter(column, kind.columns))
        if answer := whole or said.get(column) or _of_its_joint(column, said):
            place, unit, scale = answer
            state, where = (LEFT, ()) if place == "skip" else (TAKEN, (place,))
            out.append(Guess(k, column, state, where, unit or name.unit, scale, "said with --set", said=True))
            continue
        told = kind.sheets[0].units.get(column, "")
        name = replace(name, unit=told) if told and told != DATE else name
        found = role(name, set(context(kind.sheets[0])))
        if told == DATE:
            found = Role(("t",), "dates or times of day")
        if found.places and not np.isfinite(kind.values(column)).any() and not _of_a_joint(found.places):
            if not (found.places[0].startswith(("joint.", "pose.", "power.")) and kind.doubt(column)):
                found = Role(why="holds no number")
        places = tuple(place.replace("#", str(name.number)) if name.number is not None else place for place in found.places)
        doubt = column_guess.doubt(kind, column, places[0])[0] if places else ""
        state = LEFT if not places else TAKEN if len(places) == 1 and not doubt else UNCLEAR
        out.append(Guess(k, column, state, places, told or name.unit, why=doubt or found.why))
    return out


def _of_its_joint(column: str, said: dict) -> tuple[str, str, float] | None:
    """Place of a joint's rate, from the user's statement on its angle; None without one."""
    angle = said.get(column.removesuffix(STATE["velocity"]))
    if angle is None or not column.endswith(STATE["velocity"]):
        return None
    return (angle[0].replace("joint.j", "joint.w"), "", 1.0) if angle[0].startswith(("joint.j", "skip")) else None


def _of_a_joint(places: Sequence[str]) -> bool:
    return all(re.fullmatch(r"(cmd\.c|joint\.j)(#|\d+)", place) for place in places)


def _silent(guesses: list[Guess], found: Sequence[FileKind]) -> list[Guess]:
    """Handles joints without any value: asks if other joints of the table have values, else leaves them out."""
    dead = [_of_a_joint(g.places) and not np.isfinite(found[g.kind].values(g.column)).any() for g in guesses]
    alive = {(g.kind, _family(p)) for g, no in zip(guesses, dead, strict=True) if not no for p in g.places}
    why = "holds no number, other joints of its table do: was it unplugged?"
    out = []
    for g, no in zip(guesses, dead, strict=True):
        lost = any((g.kind, _family(p)) in alive for p in g.places)
        no = no and not found[g.kind].doubt(g.column)
        out.append(g if not no or g.said else g.unclear(why) if lost else g.left("holds no number"))
    return out


def _commanded_or_measured(guesses: list[Guess]) -> list[Guess]:
    """Decides ambiguous angles: measured beside commanded ones; otherwise commanded for a servo, unclear for a joint."""
    commanded = any(g.state == TAKEN and g.place.startswith("cmd.c") for g in guesses)
    measured_ = any(g.state == TAKEN and g.place.startswith("joint.j") for g in guesses)
    servo = {g.column for g in guesses if header.parse(g.column).has(header.SERVO)}
    out = []
    for g in guesses:
        if g.state == UNCLEAR and len(g.places) == 2 and g.places[0].startswith("cmd.c"):
            if commanded != measured_:
                why = "an angle beside commanded ones: measured" if commanded else "an angle beside measured ones: commanded"
                g = replace(g, state=TAKEN, places=(g.places[1 if commanded else 0],), why=why)
            elif g.column in servo and not any(
                o.column not in servo and o.state == UNCLEAR and o.places[:1] == g.places[:1] for o in guesses
            ):
                g = replace(g, state=TAKEN, places=(g.places[0],), why="a servo's angle, none called measured: commanded")
        out.append(g)
    return out


def _from_one(guesses: list[Guess]) -> list[Guess]:
    """Moves numbers that count from 0 up by one, a family at a time."""
    families: dict[str, list[int]] = {}
    for i, g in enumerate(guesses):
        if not g.said and g.place and (found := _NUMBER.search(g.place)):
            families.setdefault(_NUMBER.sub("#", g.place).rstrip("xy"), []).append(i)
            if int(found[0]) > 999:
                guesses[i] = g.left("its number is beyond any joint's")
    for mine in families.values():
        if any(_NUMBER.search(guesses[i].place)[0] == "0" for i in mine if guesses[i].place):  # type: ignore[index]
            for i in mine:
                g = guesses[i]
                moved = tuple(_NUMBER.sub(lambda m: str(int(m[0]) + 1), place) for place in g.places)
                guesses[i] = replace(g, places=moved, why=g.why + "; counted from 0")
    return guesses


def _numbered(guesses: list[Guess]) -> list[Guess]:
    """Checks that numbers count from 1 without holes; a single column without a number is the first."""
    out = _from_one(list(guesses))
    for template in ("cmd.c", "joint.j", "joint.w", "joint.temp", "joint.load", "cmd.on"):
        mine = [
            i
            for i, g in enumerate(out)
            if g.state == TAKEN and not g.said and re.fullmatch(re.escape(template) + r"(#|\d+)", g.place)
        ]
        bare = [i for i in mine if out[i].place.endswith("#")]
        order = header.nose_to_tail([header.parse(out[i].column) for i in mine]) if bare else None
        if order:
            for i, n in zip(mine, order, strict=True):
                out[i] = replace(out[i], places=(f"{template}{n}",), why=f"{out[i].why}; number {n} from the nose by its part")
            bare = []
        elif len(bare) == 1 and len(mine) == 1:
            out[bare[0]] = replace(out[bare[0]], places=(template + "1",), why=out[bare[0]].why + "; the only one")
        elif bare:
            places = tuple(f"{template}{n + 1}" for n in range(len(mine)))
            for i in bare:
                out[i] = out[i].unclear("which joint is it, counted from the nose?", places=places)
        if template in ("cmd.c", "joint.j"):
            out = column_guess.without_holes(out, [i for i in mine if i not in bare], template)
    if any(g.place.endswith("#") for g in out):
        out = [g.left("needs a number") if g.place.endswith("#") and g.state == TAKEN else g for g in out]
    return [replace(g, places=tuple(p.replace("#", "1") for p in g.places)) for g in out]


def _counts(guesses: list[Guess]) -> list[Guess]:
    """Asks which joint each column belongs to, if there are fewer commands than joints or fewer joints than commands."""
    known = [i for i, g in enumerate(guesses) if g.state == TAKEN or g.state == UNCLEAR and len(g.places) == 1]
    mine = {t: [i for i in known if guesses[i].place.startswith(t)] for t in ("cmd.c", "joint.j")}
    few, many = sorted(mine, key=lambda t: len({guesses[i].place for i in mine[t]}))
    if not mine[few] or len(mine[few]) == len(mine[many]):
        return guesses
    out = list(guesses)
    for i in mine[few]:
        why = f"{len(mine[few])} of {few}1.. beside {len(mine[many])} of {many}1..: which joint is it?"
        if not out[i].said and out[i].state == TAKEN:
            out[i] = out[i].unclear(why, places=tuple(f"{few}{n + 1}" for n in range(len(mine[many]))))
    return out


def _nameless_joints(guesses: list[Guess], found: Sequence[FileKind]) -> list[Guess]:
    """Asks about numbered columns of one unknown name, such as m1, m2, m3, in a log without joints: they may be these."""
    if any(g.place.startswith(("cmd.", "joint.")) for g in guesses):
        return guesses
    rows: dict[tuple[int, tuple[str, ...]], dict[int, int]] = {}  # by kind and words: number -> index
    for i, g in enumerate(guesses):
        name = header.parse(g.column)
        if g.state == LEFT and not g.said and g.why in (header.UNKNOWN, header.PULSES) and name.number is not None:
            values = found[g.kind].values(g.column)
            if len(np.unique(values[np.isfinite(values)])) > 1:
                rows.setdefault((g.kind, name.words), {})[name.number] = i
    out = list(guesses)
    for numbers in rows.values():
        first = min(numbers)
        if len(numbers) < 2 or first > 1 or sorted(numbers) != list(range(first, first + len(numbers))):
            continue
        for number, i in numbers.items():
            joint = number - first + 1
            why = f"may be joint {joint} of {len(numbers)}, commanded or measured; =skip leaves it out"
            if out[i].why == header.PULSES:
                why, out[i] = f"{why}; {header.PULSES}", replace(out[i], unit="", fits=("deg*SCALE",))
            out[i] = out[i].unclear(why, places=(f"cmd.c{joint}", f"joint.j{joint}"))
    return out


def _units(kind: FileKind, guesses: list[Guess]) -> list[Guess]:
    """Gives every column with a place a unit: from its name or file, else from the values of its family."""
    out = []
    doubts: dict[tuple[str, str], tuple[str, Sequence[str]]] = {}  # by unit and sensor
    known: dict[tuple[str, str], tuple[str, str]] = {}  # by family: its values are looked at once
    for g in guesses:
        if g.state == LEFT:
            out.append(g)
            continue
        table, _, column = g.place.partition(".")
        what = "time" if g.place == "t" else measured(table, column)
        if g.unit and g.unit != DATE and measures(g.unit) != what:
            if g.said:
                raise LogError(
                    f"--set {quoted(g.column)}: {g.unit} measures {measures(g.unit)}; {g.place} is in {SI.get(what) or 'no unit'}"
                )
            counted = what == "angle" and measures(g.unit) in ("count", "share", "time")
            why = f"{g.unit} of a servo. {column_units.TICKS}" if counted else f"{g.unit} is no unit of {g.place}"
            out.append(g.unclear("; ".join(filter(None, (kind.doubt(g.column), why))), fits=COUNTED * counted))
            continue
        if g.said and (g.unit or g.scale != 1.0):
            out.append(g)
        elif g.unit:
            if (shared := (g.unit, _sensor(g, what))) not in doubts:
                alike = [kind.values(o.column) for o in guesses if o.state != LEFT and (o.unit, _sensor(o, what)) == shared]
                doubts[shared] = column_units.against(g.unit, "joint" if _of_a_joint(g.places) else what, alike)
            doubt, fits = doubts[shared]
            if g.unit == "px":
                doubt = "px: say the metres of a pixel, and y's direction, in a map"
            out.append(g.unclear(doubt, fits=tuple(fits)) if doubt else g)
        elif not what:
            out.append(g)
        else:
            family = (_family(g.place), what if what != "length" else "")
            if family not in known:
                known[family] = _of_all_files(kind, guesses, g, what)
            unit, why = known[family]
            if what == "angle" and unit == "deg" and header.parse(g.column).words in (("c",), ("j",)):
                unit, why = "", f"{why}; the schema's name, but no rad: degrees, or no angle at all?"
            beside = any(o.unit == "deg" for o in guesses) and not why.startswith(("wraps", "all zero"))
            if what == "angle" and unit == "rad" and beside:
                unit, why = "", f"{why}: rad, or deg as other columns of the file?"
            state = UNCLEAR if not unit else g.state
            fits = ("rad" if ": rad" in why else "deg", *COUNTED) if why.endswith(column_units.TICKS) else g.fits
            asked = re.split(r"[ ?]", why) if what in ("time", "angle", "acceleration") else []
            rare = [u for u in asked if measures(u.partition("*")[0]) == what and ("*" in u or u in column_units.RARE)]
            if rare:
                fits = (*(column_units.likely(what) if what != "angle" else ()), *rare)
            out.append(replace(g, unit=unit, state=state, why=f"{g.why}; {why}", fits=fits))
    return [g if g.state == LEFT or g.said else column_guess.doubted(kind, g) for g in out]


def _sensor(g: Guess, what: str) -> str:
    """Key shared by columns whose names state one unit: x and y of one table, joints of one kind; a stamp has its own."""
    return g.column if what == "time" else g.table if what == "length" else _family(g.place)


def _of_all_files(kind: FileKind, guesses: list[Guess], g: Guess, what: str) -> tuple[str, str]:
    """Unit by the values, and the reason; no unit if a file of the kind reads as another unit than all together."""
    unit, why = _by_value(kind, guesses, g, what)
    for sheet in kind.sheets[:16] if unit and len(kind.sheets) > 1 else ():
        alone, told = _by_value(replace(kind, sheets=(sheet,)), guesses, g, what)
        if alone in ("", unit):
            continue
        mine = [sheet.columns[o.column] for o in guesses if o.state != LEFT and _family(o.place) == _family(g.place)]
        if what not in ("angle", "rate") or any(map(column_units.moves, mine)):
            why = f"{bare(sheet.name)} alone reads as {alone} ({told}), the files together as {unit} ({why})"
            return "", f"{why}: import it by itself, or say one unit for all"
    return unit, why


def _by_value(kind: FileKind, guesses: list[Guess], g: Guess, what: str) -> tuple[str, str]:
    family = _family(g.place)
    mine = [o for o in guesses if o.state != LEFT and not o.unit and _family(o.place) == family]
    if what == "time":
        unit, why = column_units.time_unit(kind.sheets[0].columns[g.column])
        ticks = unit == "us" and header.parse(g.column).has({"tick", "ticks"})
        return ("", f"{why}: ns*100 (ticks of .NET) or us?") if ticks else (unit, why)
    if what == "angle" and g.place.endswith("yaw"):
        return column_units.heading_unit(kind.values(g.column))
    if what == "length":
        beside = [o for o in guesses if o.state != LEFT and o.table == g.table]
        axes = [o for o in beside if measured(*o.place.split(".")) == "length"]
        spoken = {o.unit for o in axes if o.unit}
        if len(spoken) == 1:
            said, silent = ([kind.values(o.column) for o in axes if bool(o.unit) == known] for known in (True, False))
            return column_units.other_axis(spoken.pop(), said, silent)
        return column_units.length_unit([s.columns[o.column] for o in axes for s in kind.sheets[:16]])
    if what == "acceleration":
        middle = float(np.nanmedian(np.abs(kind.values(g.column))))
        return ("m/s^2", "no unit said") if middle > 0.1 or not middle else ("", "m/s^2 or g?")
    if what == "angle" and (doubt := column_units.angles_doubt({o.column: kind.values(o.column) for o in mine}, family)):
        return "", doubt
    if what == "current" and header.parse(g.column).words == ("current", "battery"):
        return "", "mA, or MAVLink's hundredths of A (A*0.01)?"
    if what in column_units.BY_VALUE:
        return column_units.BY_VALUE[what](np.concatenate([kind.values(o.column) for o in mine or [g]]))
    return SI.get(what, ""), "no unit said"


def _family(place: str) -> str:
    """Key shared by columns of one unit: joints of one kind; x and y; stamps, heading and supply have their own."""
    return re.sub(r"\d+(?=[xy]?\Z)", "", place)


def _split_stamp(guesses: list[Guess], stamps: list[int], kind: FileKind) -> tuple[int, int] | None:
    """Columns of seconds and of the nano-, micro- or milliseconds within them, as ROS and C export stamps."""
    whole, part = sorted(stamps, key=lambda i: guesses[i].unit != "s")
    if guesses[whole].unit != "s" or guesses[part].unit not in PARTS or guesses[part].said or kind.doubt(guesses[part].column):
        return None
    seconds, within = (kind.values(guesses[i].column) for i in (whole, part))
    step = np.diff(seconds + within / 1e3)
    rising = guesses[part].unit != "ms" or bool(((step >= 0) | (step < -59)).all())  # at a minute's end it may begin again
    if not (np.nan_to_num(seconds) % 1 == 0).all() or not rising:
        return None
    return (whole, part) if 0 <= np.nanmin(within) and np.nanmax(within) * UNITS[guesses[part].unit][1] < 1 else None


def _of_header(tied: list[int], guesses: list[Guess], kind: FileKind) -> list[int]:
    """Stamps that every row has; among these the stamp of the message's header, the time of measurement."""
    values = {i: kind.values(guesses[i].column) for i in tied}
    whole = [i for i in tied if np.isfinite(values[i]).all()] or tied
    header_ = [i for i in whole if header.parse(guesses[i].column).words[-2:] == ("header", "stamp") and (values[i] > 0).all()]
    return header_ if len(header_) == 1 else whole


def _other_clock(kind: FileKind, one: Guess, other: Guess) -> str:
    """Difference of two columns of stamps in words; "" if they are of one clock."""
    both = [(sheet.columns[one.column], sheet.columns[other.column]) for sheet in kind.sheets[:16]]
    apart = max(column_units.clocks_apart(*stamps, (one.unit, other.unit)) for stamps in both)
    camera = header.parse(one.column).has(header.CAMERA) != header.parse(other.column).has(header.CAMERA)
    told = f", up to {apart:.2g} s apart" if apart else ", one of the camera" if camera else ""
    return f"{told} (in a map each table may have its own)" if told else ""


def _once(guesses: list[Guess], found: Sequence[FileKind]) -> list[Guess]:
    """Leaves one column for each place: two for one place are unclear. Of several stamps, the clearest name decides."""
    out = list(guesses)
    for k in {g.kind for g in out}:
        stamps = [i for i, g in enumerate(out) if g.kind == k and g.place == "t" and g.state != LEFT]
        if len(stamps) == 2 and (pair := _split_stamp(out, stamps, found[k])):
            place = f"t.{PARTS[out[pair[1]].unit]}"
            out[pair[1]] = replace(out[pair[1]], places=(place,), why="added to the seconds beside it")
            stamps = [pair[0]]
        if len(stamps) > 1:
            rank = [(not out[i].said, out[i].state != TAKEN, header.parse(out[i].column).unit == "", i) for i in stamps]
            best = min(rank)
            lower = [r[-1] for r in rank if r[:-1] > best[:-1]]
            tied = _of_header([r[-1] for r in rank if r[:-1] == best[:-1]], out, found[k])
            best = next((r for r in rank if tied == [r[-1]]), best)
            clocks = {i: "" if out[best[-1]].said else _other_clock(found[k], out[best[-1]], out[i]) for i in lower}
            tied += [i for i in lower if clocks[i]]
            for i in stamps:
                if len(tied) > 1 and i in tied:
                    form = next(filter(None, (found[k].doubt(out[j].column) for j in tied)), "")
                    several = f"{len(tied)} columns of time{max(clocks.values(), default='')}: which stamps the row?"
                    out[i] = out[i].unclear(form or several)
                elif i != best[-1]:
                    out[i] = out[i].left("another column of time is taken")
    places: dict[str, list[int]] = {}
    for i, g in enumerate(out):
        if g.place and g.table != "t" and g.state == TAKEN:
            places.setdefault(g.place, []).append(i)
    for place, mine in places.items():
        said = [i for i in mine if out[i].said]
        for i in mine if len(mine) > 1 else []:
            if said and i not in said:
                out[i] = out[i].left(f"another column was said to be {place}")
            elif not said or len(said) > 1:
                others = ", ".join(quoted(out[o].column) for o in mine if o != i)
                there = next((bare(found[out[o].kind].sheets[0].name) for o in mine if out[o].kind != out[i].kind), "")
                way = f" Leave a whole file or topic out with --set {typed(there)}=skip" if there else ""
                out[i] = out[i].unclear(f"{place} is also {others}{f' of {there}' if there else ''}: which?{way}")
    return out


def _upright(guesses: list[Guess], found: Sequence[FileKind]) -> list[Guess]:
    """Asks about a y that hardly moves beside a z that does: trackers of motion often count y upwards."""
    out = list(guesses)
    for i, g in enumerate(guesses):
        if g.state != TAKEN or g.said or g.place not in ("pose.y", "target.y"):
            continue
        name, kind = header.parse(g.column), found[g.kind]
        of = {header.parse(c).words: c for c in kind.columns if header.parse(c).number == name.number}
        beside = [of.get(tuple(axis if word == "y" else word for word in name.words)) for axis in "xyz"]
        x, y, z = (column_units.spread([kind.values(c)] if c else []) for c in beside)
        if z > FLAT * y and z > 0.01 * x:
            why = f"its z spans {z:.3g}, y {y:.3g}: is y the height? Then map z for y, sign = -1 if x, y, z are right-handed"
            out[i] = g.unclear(why)
    return out


def _points(guesses: list[Guess]) -> list[Guess]:
    """Treats a place without a heading as a point on the body, not as a pose."""
    kinds_ = {g.kind for g in guesses if g.place in ("pose.x", "pose.y") and g.state != LEFT}
    if not kinds_ or any(g.place == "pose.yaw" and g.state != LEFT for g in guesses):
        return guesses
    if any(g.place.startswith("markers.") for g in guesses):
        return guesses
    out = list(guesses)
    for k in kinds_:
        mine = [i for i, g in enumerate(guesses) if g.kind == k and g.place in ("pose.x", "pose.y") and not g.said]
        names = {i: header.parse(guesses[i].column) for i in mine if guesses[i].state != LEFT}
        points = list(dict.fromkeys(_point(name) for name in names.values()))
        order = header.nose_to_tail(points) if len(points) > 1 else [1]
        for i, name in names.items():
            axis, why = guesses[i].place[-1], guesses[i].why + "; no heading, so a point and no pose"
            if order:
                out[i] = replace(guesses[i], places=(f"markers.p{order[points.index(_point(name))]}{axis}",), why=why)
            else:
                places = tuple(f"markers.p{n + 1}{axis}" for n in range(len(points)))
                out[i] = guesses[i].unclear("which point is it, counted from the nose?", places=places)
    return out


def _point(name: header.Header) -> header.Header:
    """The name of a point without its axis and unit."""
    return header.Header(tuple(word for word in name.words if word not in header.AXES), name.number)


def _complete(guesses: list[Guess], found: Sequence[FileKind]) -> list[Guess]:
    """Asks about columns that would be lost: without stamps, without another column of their table, or in a second file."""
    out = list(guesses)
    for k, kind in enumerate(found):
        mine = [i for i, g in enumerate(out) if g.kind == k and g.state != LEFT and g.table != "t"]
        if mine and not any(g.kind == k and g.place == "t" and g.state != LEFT for g in out):
            out = _stampless(out, kind, k, mine)
            continue
        for table in {out[i].table for i in mine}:
            have = {g.place.partition(".")[2] for g in out if g.kind == k and g.state != LEFT and g.table == table}
            spec = table_spec(table)
            need = spec.fixed[1:] or tuple(t.replace("#", "1") for t in spec.numbered)
            lacking = [column for column in need if column not in have]
            if lacking:
                globe = f"; {header.GLOBE}" if any(header.on_globe(header.parse(c)) for c in kind.columns) else ""
                why = f"table {table} also needs {', '.join(lacking)}: say which columns they are, or skip this one{globe}"
                out = [g.unclear(why) if i in mine and g.table == table and not g.said else g for i, g in enumerate(out)]
    first: dict[str, int] = {}
    for i, g in enumerate(out):
        table = g.table if g.state != LEFT and g.table != "t" else ""
        if table and first.setdefault(table, g.kind) != g.kind:
            out[i] = g.unclear(
                f"table {table} lies in another file already; a table of ours is one file with one clock: skip one"
            )
    return out


def _stampless(guesses: list[Guess], kind: FileKind, k: int, mine: Sequence[int]) -> list[Guess]:
    """Asks, in a file without a named time, about the rising columns that may be the stamps; without one, about all columns."""
    out, again = list(guesses), ""
    for i, g in enumerate(out):
        if g.kind == k and g.state == LEFT and not g.said:
            values = kind.sheets[0].columns[g.column]
            step = np.diff(values[np.isfinite(values)])
            if (step < 0).any() and (step % 1 == 0).all() and np.mean(step == 1) > 0.5:
                again = f" ({quoted(g.column)} counts the rows, but begins again: split the file there)"
            if len(step) and (step >= 0).all() and 2 * (step > 0).sum() > len(step):
                rows = bool((step % 1 == 0).all() and np.median(step) == 1)  # with frames that were dropped
                why = "it counts the rows, say the seconds of one" if rows else "it rises"
                out[i] = g.unclear(
                    f"no column of time among the names; is it this one? {why}", places=("t",), fits=("s*SECONDS",) * rows
                )
    if not any(g.kind == k and g.state == UNCLEAR and g.place == "t" for g in out):
        form = table_forms.without_time(kind.sheets[0].columns) or column_guess.lost_time(kind)
        why = f"its file has no column of time{f' ({form})' if form else again}: skip it, or write one"
        out = [g.unclear(why) if i in mine and not g.said else g for i, g in enumerate(out)]
    return out
