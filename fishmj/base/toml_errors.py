"""Explains a TOML syntax error to someone who does not know the grammar: line, text, block, what to do.

line 44, 'mass = 0,744', in [[link]] 4: a decimal comma; write a point, 0.744
"""

import re

SEVERAL = ("link", "fin", "effect")  # blocks of a robot description that may stand several times, [[...]]
SHOWN = 60  # characters of a line
_HEADER = re.compile(r"\s*(\[\[?)[ \t]*([A-Za-z_\"'][\w.\"'-]*)[ \t]*\]{1,2}[ \t]*(?:#.*)?")
_PLACE = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)$")
_LONGEST = 2000  # characters of a line or a value that are looked at: a hostile file must not cost time by their square
_KEY = re.compile(r"\s*([A-Za-z0-9_.-]{1,64}|\"[^\"\n]{1,64}\")[ \t]*=")
_QUOTES = "\u201c\u201d\u201e\u201f\u2018\u2019\u201a\u00ab\u00bb\u2033\u2032"
_MERGE = re.compile(r"(?:<{7}|={7}|>{7}|\|{7})(?:\s|$)")
_NUMBER = r"[+-]?\d[\d_]*(?:\.\d+)?(?:[eE][+-]?\d+)?"


def explained(text: str, error: ValueError) -> str:
    """One-line explanation in place of tomllib's message on `text`, without the name of the file."""
    message = " ".join(str(error).split())
    lines = text.replace("\r\n", "\n").split("\n")
    if kind := _another_format(text):
        return f"line 1, {_shown(lines[0])}: {kind}"
    if "digits" in message:
        for run in re.finditer(r"\d[\d_]*", text):
            if len(run[0]) > 4300:
                return _at(lines, text.count("\n", 0, run.start())) + f": a number of {len(run[0])} digits, expected 18 at most"
    place = _PLACE.search(message[-80:])
    at = min(int(place[1]), len(lines)) - 1 if place and place[1] else len(lines) - 1
    while place and not place[1] and at and not lines[at].strip():  # the end of the document: the last line that has text
        at -= 1
    column = int(place[2]) - 1 if place and place[2] else len(lines[at])
    bare = message[: len(message) - len(place[0]) if place else None][:300]
    if (began := _open_bracket(lines, at, column)) is not None and not _MERGE.match(lines[at]):
        return _at(lines, began) + ": " + _unclosed(lines, began, at)
    return _at(lines, at) + ": " + (_twice(lines, at, bare) or _guess(lines[at][:_LONGEST], bare) or _plain(bare))


def _another_format(text: str) -> str:
    start = text.lstrip()[:200]
    toml = "expected TOML; docs/simulate/your_own_fish.md shows a description"
    if start.startswith("<") and not start.startswith("<<"):
        return f"this is XML, such as a MuJoCo model; {toml}"
    if start.startswith("{") or re.match(r"\[\s*[{\[\"]", start) and not re.match(r"\[\[\s*[A-Za-z_]", start):
        return f"this is JSON; {toml}"
    return f"this is YAML; {toml}" if re.match(r"(---|%YAML)\s", start) else ""


def _at(lines: list[str], at: int) -> str:
    """Place of a line in words: `line 44, 'mass = 0,744', in [[link]] 4`."""
    block = "" if _HEADER.fullmatch(lines[at]) else _block(lines, at)[0]
    return f"line {at + 1}, {_shown(lines[at])}" + (f", in {block}" if block else "")


def _shown(line: str) -> str:
    short = line.strip()
    short = short if len(short) <= SHOWN else short[: SHOWN - 3] + "..."
    return "'" + "".join(c if c.isprintable() else "?" for c in short) + "'"


def _block(lines: list[str], at: int) -> tuple[str, int]:
    """(header of the block around line `at`, its line), ("", -1) at the top of the file."""
    for i in range(at - 1, -1, -1):
        if found := _HEADER.fullmatch(lines[i]):
            name = found[2][:SHOWN]
            if found[1] == "[":
                return f"[{name}]", i
            nth = sum((m := _HEADER.fullmatch(line)) is not None and m[1] == "[[" and m[2] == found[2] for line in lines[: i + 1])
            return f"[[{name}]] {nth}", i
    return "", -1


def _open_bracket(lines: list[str], at: int, column: int) -> int | None:
    """Line of the outermost [ or { that is open at the error; None if none is open, or if it opened on that line."""
    _, header = _block(lines, at)
    open_at: list[int] = []
    text = False  # within a text of several lines
    for i in range(header + 1, at + 1):
        line, quote, k = lines[i] if i < at else lines[i][:column], "", 0
        if (line.count('"""') + line.count("'''")) % 2:
            text = not text
            continue
        if text or (not open_at and "=" not in line):
            continue
        while k < len(line):
            c = line[k]
            if quote:
                k += c == "\\" and quote == '"'
                quote = "" if c == quote else quote
            elif c in "\"'":
                quote = c
            elif c == "#":
                break
            elif c in "[{":
                open_at.append(i)
            elif c in "]}" and open_at:
                open_at.pop()
            k += 1
    return open_at[0] if open_at else None


def _unclosed(lines: list[str], began: int, at: int) -> str:
    inside = "\n".join(lines[began : at + 1])[:_LONGEST]
    if guess := _quotes(inside):
        return guess
    if re.search(rf"{_NUMBER}[ \t]+{_NUMBER}", inside) or re.search(rf"{_NUMBER}[ \t]*\n[ \t]*{_NUMBER}", inside):
        return "numbers without commas between; write [[0.0, 0.078, 0.048], [0.07, 0.066, 0.036]]"
    if ";" in re.sub(r'"[^"]*"|#[^\n]*', "", inside):
        return "a ; between numbers; write a comma"
    if re.search(r"\][ \t\n]*\[", inside):
        return "two rows without a comma between; write [..], [..]"
    where = "" if began == at else f" before line {at + 1}"
    return f"a [ that is opened here is not closed{where}; count the brackets, or look for a comma that is missing"


def _twice(lines: list[str], at: int, told: str) -> str:
    """Explanation of a key or a block that occurs twice."""
    line = lines[at]
    if header := _HEADER.fullmatch(line):
        name = header[2]
        same = [i for i in range(at) if (m := _HEADER.fullmatch(lines[i])) and m[2] == name]
        if not same:
            return ""
        if name in SEVERAL:
            return f"several such blocks are written [[{name}]], with two brackets, each of them"
        return f"[{name[:SHOWN]}] stands twice, first in line {same[0] + 1}; keep one: a file describes one robot"
    if not (key := _KEY.match(line)) or not ("overwrite" in told or "uplicate" in told or "already" in told):
        return ""
    block, header_at = _block(lines, at)
    same = [i for i in range(header_at + 1, at) if (m := _KEY.match(lines[i])) and m[1].strip('"') == key[1].strip('"')]
    first = f", first in line {same[0] + 1}" if same else ""
    hint = "; is a [[header]] missing between them?" if block.startswith("[[") else ""
    return f"{key[1]} stands twice in {block or 'the top of the file'}{first}; keep one{hint}"


def _quotes(line: str) -> str:
    before = re.sub(r'"[^"]*"', "", line).split("#")[0]
    return 'curly quotes of a word processor; write straight ones, "text"' if any(c in _QUOTES for c in before) else ""


def _guess(line: str, told: str) -> str:
    """Explanation of an error within one line."""
    if _MERGE.match(line):
        return "the mark of a merge of two versions; keep one side and take out the three marks"
    if guess := _quotes(line):
        return guess
    code = re.sub(r'"[^"]*"', '""', line).split("#")[0].rstrip()
    if found := re.search(r"=\s*([+-]?\d+),(\d+)\s*$", code):
        return f"a decimal comma; write a point, {found[1]}.{found[2]}"
    if re.match(r"\s*(//|;|%|/\*|--)", line):
        return "a comment begins with #"
    if re.match(r"\s*[\w.-]+\s*:", code) and not _KEY.match(code):
        return "a : where TOML has =; write key = value"
    if found := re.search(r"=.*?[\s\"\]]([A-Za-z_][\w-]*)\s*=(?!=)", code):
        return f"two statements on one line; begin a new line before {found[1][:SHOWN]}"
    if code.endswith(";"):
        return "a ; at the end; take it out"
    if re.match(r"\s*\[+[^\]]*\]?$", code) and code.count("[") != code.count("]"):
        return "a header closes with as many brackets as it opens, [servo] or [[link]]"
    return _value(code, told)


def _value(code: str, told: str) -> str:
    """Explanation of an error behind the =."""
    key, sign, value = code.partition("=")
    value = value.strip()
    if not sign:
        return "no statement; write key = value, or # before a remark" if "key" in told or "statement" in told else ""
    if not value:
        return "no value behind the =; write one, or take the line out"
    if value.startswith("="):
        return "two signs =; write one"
    if value in ("True", "False"):
        return f"write {value.lower()}, in small letters"
    if re.fullmatch(r"[+-]?\.\d+|[+-]?\d+\.", value):
        return "a digit must stand on both sides of the point, such as 0.5 or 5.0"
    if re.fullmatch(r"[+-]?0\d+(\.\d+)?", value):
        return "a number with zeros in front; take them out"
    if found := re.fullmatch(rf"({_NUMBER})\s*([A-Za-z%\u00b0\u00b5\u03bc].*)", value):
        return f"a number with its unit; write {found[1]} in the unit of the key, the unit behind a #"
    if "\\" in value or "Unescaped" in told:
        return "a backslash in text; write / or two of them"
    if value.count('"') % 2 or value.count("'") % 2:
        return "a quote that is opened is not closed on its line"
    if re.match(r"[A-Za-z_/]", value):
        return f'text without quotes; write {key.strip()[:SHOWN]} = "{value[:SHOWN]}"'
    return ""


def _plain(told: str) -> str:
    """tomllib's message without Python's types."""
    names = re.sub(r"\(('[^']*'(?:, '[^']*')*),?\)", lambda m: m[1].replace("'", "").replace(", ", "."), told)
    return "".join(c if c.isprintable() else "?" for c in names[:120])
