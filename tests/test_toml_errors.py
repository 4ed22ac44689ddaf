"""A text that is no TOML: the line, its text, its block, and what to do, for someone who never read the grammar."""

import pytest

from fishmj.base.calib import parse_toml
from fishmj.base.errors import ConfigError

HEAD = '[body]\n\n[[link]]\nname = "head"\n[[link]]\nname = "tail"\n'
IN = "in [[link]] 2"
CASES = {
    "decimal_comma": ("mass = 0,744", 7, "a decimal comma; write a point, 0.744"),
    "colon": ("mass: 0.7", 7, "write key = value"),
    "curly": ("colour = \u201cred\u201d", 7, "curly quotes"),
    "curly_in_a_list": ("colour = [\u201cred\u201d]", 7, "curly quotes"),
    "two_statements": ('title = "x" mass = 1', 7, "begin a new line before mass"),
    "unclosed": ("com = [1, 2\nmass = 0.7\n", 7, "is not closed before line 8"),
    "unclosed_twice": ("sections = [[1, 2, 3],\n  [4, 5, 6]\nmass = 0.7\n", 7, "is not closed before line 9"),
    "unclosed_at_the_end": ("com = [1, 2\n", 7, "is not closed"),
    "no_commas": ("com = [1 2 3]", 7, "numbers without commas"),
    "rows_without_comma": ("sections = [[1, 2, 3]\n[1, 2, 3]]", 7, "two rows without a comma"),
    "merge": ("<<<<<<< HEAD\nmass = 1\n=======\nmass = 2\n>>>>>>> b", 7, "keep one side"),
    "twice": ("mass = 1\nlength = 2\nmass = 3", 9, r"mass stands twice in \[\[link\]\] 2, first in line 7"),
    "unit": ("mass = 0.7 kg", 7, "a number with its unit; write 0.7"),
    "no_quotes": ("name2 = head", 7, 'text without quotes; write name2 = "head"'),
    "truth": ("x = True", 7, "write true"),
    "nothing": ("mass =", 7, "no value behind the ="),
    "no_statement": ("mass", 7, "write key = value"),
    "slashes": ("// a remark", 7, "a comment begins with #"),
    "semicolon": ("mass = 1;", 7, "a ; at the end"),
    "half_a_point": ("mass = .5", 7, "both sides of the point"),
    "quote": ('title = "x', 7, "a quote that is opened is not closed"),
    "backslash": (r'title = "C:\data"', 7, "a backslash"),
    "zeros": ("mass = 007", 7, "zeros in front"),
}


@pytest.mark.parametrize("kind", CASES)
def test_a_mistake_is_told_with_its_line_its_block_and_what_to_do(kind):
    text, line, told = CASES[kind]
    for end in ("\n", "\r\n"):
        with pytest.raises(ConfigError, match=told) as caught:
            parse_toml((HEAD + text).replace("\n", end), "my_fish.toml")
        message = str(caught.value)
        assert message.startswith(f"my_fish.toml: not valid TOML: line {line}, '") and IN in message
        assert message.isprintable() and len(message) < 400


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[link]\na = 1\n[link]\na = 2", r"line 3, '\[link\]': several such blocks are written \[\[link\]\]"),
        ("[body]\na = 1\n[servo]\n[body]\n", r"line 4, '\[body\]': \[body\] stands twice, first in line 1"),
        ("[body\na = 1", "line 1.*as many brackets"),
        ('<?xml version="1.0"?>\n<mujoco/>', "this is XML"),
        ('{\n "schema": 1\n}', "this is JSON"),
        ('[{"a": 1}]', "this is JSON"),
        ("---\na: 1\n", "this is YAML"),
        ("a = 1\nb = " + 5000 * "7", "line 2, 'b = 7777.*a number of 5000 digits"),
        ('notes = """\nx = [ a : b\n"""\nmass = 0,7\n', "line 4, 'mass = 0,7': a decimal comma"),
        ("mass = \x1b[2J\n", r"line 1, 'mass = \?\[2J'"),
    ],
)
def test_other_formats_and_blocks_that_stand_twice_are_told(text, told):
    with pytest.raises(ConfigError, match=told) as caught:
        parse_toml(text, "x.toml")
    message = str(caught.value)
    assert message.isprintable() and "sys." not in message and "('" not in message and len(message) < 400


@pytest.mark.parametrize(
    "text",
    ["a = " + 990_000 * "[1, ", "a = b" + 900_000 * "7", 300_000 * "a\n", 'a = "' + 900_000 * "x", "a = [" + 400_000 * "1\t"],
)
def test_a_hostile_text_costs_no_time_by_its_square(text):
    with pytest.raises(ConfigError):  # at a cost by the square this would take hours
        parse_toml(text[:1_000_000], "x.toml")
