"""Robot descriptions that are wrong, hostile, or merely unusual.

Written by someone who knew the docs (README, docs/simulate/your_own_fish.md) and the shipped descriptions, and not the code:
60 mistakes that builders of robotic fish make with a ruler, a CAD program, a data sheet and a spreadsheet, and 8 things that
an attacker would send. `cases` and `places` must be refused, with one clear line a mistake and nothing made of the file;
`unusual` must be accepted, with a note at most.
"""

import codecs
import json
import os
import struct
import tomllib
from pathlib import Path


def swap(text: str, old: str, new: str) -> str:
    """`old`, which must stand in `text` exactly once, replaced."""
    if text.count(old) != 1:
        raise ValueError(f"{old!r} stands {text.count(old)} times in the description, expected once")
    return text.replace(old, new)


def swaps(text: str, *pairs: tuple[str, str]) -> str:
    """One replacement after the other."""
    for old, new in pairs:
        text = swap(text, old, new)
    return text


def cut(text: str, start: str, end: str) -> str:
    """What stands from `start`, included, to `end`, left out."""
    if text.count(start) != 1 or end not in text.split(start)[1]:
        raise ValueError(f"{start!r} ... {end!r} is not in the description once")
    return start + text.split(start)[1].split(end)[0]


def effect(name: str, parameters: str) -> str:
    return f'\n[[effect]]\nname = "{name}"\nprovenance = "12 logs of 3 June, pool"\n{parameters}\n'


def typing(fish: str) -> dict[str, bytes | str]:
    """The keyboard, the editor, the clipboard."""
    body1 = "sections = [[0.0, 0.078, 0.048], [0.07, 0.066, 0.036]]"
    return {
        "mass_with_a_comma": swap(fish, "mass_total = 1.1", "mass_total = 1,1"),
        "fin_station_with_commas": swap(fish, "station = [0.10, 0.178]", "station = [0,10, 0,178]"),
        "quotes_from_a_word_processor": swap(fish, 'name = "body1"', "name = \u201ebody1\u201c"),
        "closing_bracket_lost": swap(fish, body1, body1[:-1]),
        "two_lines_merged": swap(fish, 'name = "body2"\nlength = 0.07\n', 'name = "body2" length = 0.07\n'),
        "mass_given_twice": swap(fish, "mass = 0.086\n", "mass = 0.086\nmass = 0.091\n"),
        "colon_for_equals": swap(fish, "kp = 8.0  ", "kp: 8.0  "),
        "table_pasted_with_tabs": swap(fish, body1, "sections = [\n0.0\t0.078\t0.048\n0.07\t0.066\t0.036\n]"),
        "merge_conflict": swap(fish, "mass = 0.102\n", "<<<<<<< HEAD\nmass = 0.102\n=======\nmass = 0.099\n>>>>>>> ballast\n"),
        "umlaut_in_latin_1": swap(fish, "SWiFT fish, 4 links", "Pr\u00fcfstand-Fisch, 4 Glieder").encode("latin-1"),
        "saved_as_utf_16": codecs.BOM_UTF16_LE + fish.encode("utf-16-le"),
    }


def kinds(fish: str) -> dict[str, bytes | str]:
    """A value of another kind than the key wants."""
    body1 = "sections = [[0.0, 0.078, 0.048], [0.07, 0.066, 0.036]]"
    lengths = 'name = "body1"\nlength = 0.07\n'
    return {
        "length_with_its_unit": swap(fish, lengths, 'name = "body1"\nlength = "70 mm"\n'),
        "nan_from_a_spreadsheet": swap(fish, "[0.096, 0.086, 0.007]", "[0.096, nan, 0.007]"),
        "spreadsheet_made_a_date_of_it": swap(fish, lengths, 'name = "body1"\nlength = 2026-07-01\n'),
        "voltage_of_the_data_sheet": swap(fish, "voltage = 7.4  ", "voltage = [6.0, 8.4]  "),
        "sections_without_inner_brackets": swap(fish, body1, "sections = [0.0, 0.078, 0.048, 0.07, 0.066, 0.036]"),
        "sections_of_a_round_hull": swap(fish, body1, "sections = [[0.0, 0.078], [0.07, 0.066]]"),
    }


def units(fish: str) -> dict[str, bytes | str]:
    """Right figures, other units; data sheets misread."""
    body2 = cut(fish, 'name = "body2"', "colour")
    centimetres = swaps(
        body2,
        ("length = 0.07", "length = 7.0"),
        ("com = [0.03175, 0.0, -0.015]", "com = [3.175, 0.0, -1.5]"),
        ("[[0.0, 0.066, 0.036], [0.07, 0.052, 0.026]]", "[[0.0, 6.6, 3.6], [7.0, 5.2, 2.6]]"),
    )
    grams = swaps(
        fish,
        ("mass_total = 1.1", "mass_total = 1100"),
        ("mass = 0.744", "mass = 744"),
        ("mass = 0.168", "mass = 168"),
        ("mass = 0.102", "mass = 102"),
        ("mass = 0.086", "mass = 86"),
    )
    tail = "[[0.0, 0.052, 0.026], [0.054, 0.036, 0.014], [0.060, 0.032, 0.012], [0.096, 0.086, 0.007], [0.148, 0.120, 0.004], "
    return {
        "sections_in_mm": swap(
            fish,
            tail + "[0.18, 0.120, 0.001]]",
            "[[0, 52, 26], [54, 36, 14], [60, 32, 12], [96, 86, 7], [148, 120, 4], [180, 120, 1]]",
        ),
        "one_link_in_cm": swap(fish, body2, centimetres),
        "masses_in_grams": grams,
        "battery_in_the_total_only": swap(fish, "mass_total = 1.1", "mass_total = 1.35"),
        "timing_in_ms": swaps(
            fish,
            ("physics_dt = 0.004", "physics_dt = 4"),
            ("bus_dt = 0.02 ", "bus_dt = 20 "),
            ("control_dt = 0.2 ", "control_dt = 200 "),
            ("command_latency = 0.060", "command_latency = 60"),
            ("camera_latency = 0.065", "camera_latency = 65"),
        ),
        "servo_torque_in_kg_cm": swap(fish, "torque = 1.667 ", "torque = 17.0 "),
        "servo_speed_in_s_per_60_deg": swap(fish, "speed_no_load = 5.236", "speed_no_load = 0.20"),
        "fin_span_in_a_mix_of_m_and_cm": swap(fish, "span = 0.035 ", "span = 3.5 "),
        "damping_that_the_sheet_does_not_state": swap(fish, "kd = 0.32  ", "kd = 0.0  "),
    }


def shape(fish: str) -> dict[str, bytes | str]:
    """Links, sections, fins and balance points that cannot be."""
    links = ["[[link]]\n" + part for part in cut(fish, '[[link]]\nname = "head"', "[[fin]]").split("[[link]]\n")[1:]]
    together = "".join(links)
    fall = "sections = [[0.0, 0.066, 0.036], [0.07, 0.052, 0.026]]"
    return {
        "links_tail_first": swap(fish, together, "".join(reversed(links))),
        "sections_tail_to_nose": swap(fish, fall, "sections = [[0.07, 0.052, 0.026], [0.0, 0.066, 0.036]]"),
        "sections_from_the_nose_of_the_fish": swap(fish, fall, "sections = [[0.285, 0.066, 0.036], [0.355, 0.052, 0.026]]"),
        "nose_that_ends_in_a_point": swap(fish, "[[0.0, 0.012, 0.008],", "[[0.0, 0.0, 0.0],"),
        "step_in_the_hull": swap(fish, "[0.060, 0.032, 0.012]", "[0.054, 0.032, 0.012]"),
        "fin_on_a_link_that_is_not_there": swap(fish, 'link = "head"', 'link = "body"'),
        "fin_with_its_edges_swapped": swap(fish, "station = [0.10, 0.178]", "station = [0.178, 0.10]"),
        "ballast_beside_the_middle": swap(fish, "com = [0.12076, 0.0, -0.020]", "com = [0.12076, 0.006, -0.020]"),
        "balance_point_from_the_nose_of_the_fish": swap(fish, "com = [0.03237, 0.0, -0.015]", "com = [0.24737, 0.0, -0.015]"),
        "balance_point_below_the_keel": swap(fish, "com = [0.12076, 0.0, -0.020]", "com = [0.12076, 0.0, -0.20]"),
        "two_links_of_one_name": swap(fish, 'name = "body2"', 'name = "body1"'),
        "mass_forgotten": swap(fish, "mass = 0.168\n", ""),
        "length_mistyped": swap(fish, links[3], swap(links[3], "length = 0.18", "lenght = 0.18")),
        "link_name_with_a_space": swap(fish, 'name = "body1"', 'name = "body 1"'),
    }


def nesting(fish: str) -> dict[str, bytes | str]:
    """Keys in the wrong block, blocks of the wrong kind."""
    servo = cut(fish, "[servo]", "[timing]")
    top = 'schema = "fishmj.fish/1"\nname = "swift"\n'
    fin = cut(fish, "[[fin]]", "[servo]")
    return {
        "header_of_timing_lost": swap(fish, "[timing]\n", ""),
        "name_below_body": swap(swap(fish, top, ""), "mass_total = 1.1", top + "mass_total = 1.1"),
        "links_with_one_bracket": fish.replace("[[link]]", "[link]"),
        "one_servo_block_a_joint": swap(fish, servo, 3 * servo.replace("[servo]", "[[servo]]")),
        "fin_inside_its_link": swap(fish, fin, swap(swap(fin, "[[fin]]", "[[link.fin]]"), 'link = "head"\n', "")),
        "bus_that_is_no_multiple": swap(fish, "bus_dt = 0.02 ", "bus_dt = 0.018 "),
    }


def waters(fish: str) -> dict[str, bytes | str]:
    """[water] of another fish, effects mistyped."""
    head = "k = [0.9, 0.9, 0.9, 0.8] "
    torque = "parameters.torque = { value = 0.081, low = 0.074, high = 0.089 }"
    return {
        "water_of_a_fish_of_three_links": swaps(
            fish, (head, "k = [0.9, 0.8, 0.8] "), ("cn = [1.2, 1.2, 1.2, 2.0]", "cn = [1.2, 1.9, 2.0]")
        ),
        "edge_that_would_feed_energy": swaps(fish, ("lift_a = 0.3 ", "lift_a = 0.1 "), ("lift_b = 0.7 ", "lift_b = 0.2 ")),
        "fitted_water_mistyped": swap(fish, head, f'model = "structurd"\n{head}'),
        "effect_mistyped": fish + effect("colomb_friction", torque),
        "effect_in_degrees": fish + effect("gear_backlash", "parameters.half_gap = { value = 1.5, low = 1.0, high = 2.0 }"),
        "effect_twice": fish + effect("coulomb_friction", torque) + effect("coulomb_friction", torque.replace("0.081", "0.083")),
        "effect_with_keys_at_its_own_level": fish + effect("coulomb_friction", "torque = 0.081"),
    }


def files(fish: str) -> dict[str, bytes | str]:
    """Another file altogether."""
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 215, 0, 0, 0, 94, 0, 0)
    return {
        "empty": "",
        "mujoco_model": '<mujoco model="swift">\n  <worldbody>\n    <body name="head" pos="0 0 0">\n'
        '      <geom type="ellipsoid" size="0.1 0.03 0.04"/>\n    </body>\n  </worldbody>\n</mujoco>\n',
        "description_as_json": json.dumps(tomllib.loads(fish), indent=2),
        "settings_of_a_python_project": '[project]\nname = "swift-firmware"\nversion = "0.3.1"\ndependencies = ["numpy>=2"]\n',
        "mesh_from_cad": b"solid swift_head exported by CAD".ljust(80) + struct.pack("<I", 40) + 40 * triangle,
        "photo_pasted_into_the_notes": fish + '\n[notes]\nside_view = "data:image/png;base64,' + 3_000_000 * "iVBORw0K" + '"\n',
        "two_fish_in_one_file": fish + swap(fish, 'name = "swift"', 'name = "swift2"'),
    }


def hostile(fish: str) -> dict[str, bytes | str]:
    """What an attacker would send. Each is a thing to refuse, soon, and without a trace outside."""
    code = "x';__import__('os').system('touch bad_descriptions_was_here')#"
    escape = '"\\u001b]0;owned\\u0007\\u001b[2J\\u001b[31mfishmj: all checks passed" = 1'
    return {
        "link_name_that_is_code": swap(fish, 'name = "body1"', f'name = "{code}"'),
        "name_that_is_a_path": swap(fish, 'name = "swift"', 'name = "../../../../tmp/bad_descriptions_was_here"'),
        "fin_name_that_is_a_page": swap(fish, 'name = "side"', 'name = "<script src=//evil.example/x.js></script>"'),
        "key_that_drives_the_terminal": swap(fish, "mass_total = 1.1", escape + "\nmass_total = 1.1"),
        "brackets_without_end": swap(fish, "colour = [0.20, 0.22, 0.25]", "colour = " + 200_000 * "[" + 200_000 * "]"),
        "eighty_thousand_unknown_blocks": fish + "".join(f"\n[b{i}]" for i in range(80_000)),
        "number_of_half_a_million_digits": swap(fish, "mass = 0.744", "mass = " + 500_000 * "7"),
        "water_that_is_a_device": swap(fish, "[water]\n", '[water]\nmodel = "/dev/zero"\n'),
    }


def cases(fish: str) -> dict[str, bytes | str]:
    """id -> what stands in the file. Each must be refused."""
    return {
        **typing(fish),
        **kinds(fish),
        **units(fish),
        **shape(fish),
        **nesting(fish),
        **waters(fish),
        **files(fish),
        **hostile(fish),
    }


def places(folder: Path) -> dict[str, Path]:
    """id -> a path made in `folder` that is no plain file which could be read. Each must be refused at once, never waited for."""
    names = (
        "directory",
        "fifo",
        "symlink_loop",
        "symlink_to_nothing",
        "symlink_to_an_endless_device",
        "sparse_file_of_8_gb",
        "not_there",
    )
    made = {name: folder / f"{name}.toml" for name in names}
    made["directory"].mkdir()
    os.mkfifo(made["fifo"])
    made["symlink_loop"].symlink_to(made["symlink_loop"])
    made["symlink_to_nothing"].symlink_to(folder / "nothing.toml")
    made["symlink_to_an_endless_device"].symlink_to("/dev/zero")
    with made["sparse_file_of_8_gb"].open("wb") as file:
        file.truncate(8 << 30)
    made["below_a_file"] = folder / "plain.txt" / "fish.toml"
    made["below_a_file"].parent.write_text("a file, no folder\n")
    made["name_longer_than_the_system_takes"] = folder / (300 * "x" + ".toml")
    made["name_that_drives_the_terminal"] = folder / "\x1b[2J\x1b[31mall checks passed.toml"
    made["name_that_drives_the_terminal"].write_text("[body]\nmass = 1\n")
    if os.geteuid():  # root reads everything
        made["unreadable"] = folder / "unreadable.toml"
        made["unreadable"].write_text("")
        made["unreadable"].chmod(0)
    return made


SMALL = """# a fish of two links by hand: what the page marks with a star, and nothing else
[[link]]
name = "front"
length = 0.2
mass = 0.7
sections = [[0, 0.02, 0.02], [0.05, 0.08, 0.06], [0.2, 0.07, 0.05]]

[[link]]
name = "rear"
length = 0.2
mass = 0.25
sections = [
    [0, 0.07, 0.05],   # where the skin ends
    [0.1, 0.03, 0.01],
    [0.2, 0.12, 0.002],
]
"""


def unusual(fish: str) -> dict[str, str]:
    """id -> what stands in the file. Nothing is wrong with these: each must be accepted, with a note at most."""
    servo, timing, water = cut(fish, "[servo]", "[timing]"), cut(fish, "[timing]", "[water]"), fish[fish.index("[water]") :]
    rest = fish[: fish.index("[servo]")]
    side = 'fin = [{ name = "side", link = "head", station = [0.10, 0.178], span = 0.035 }]'
    inline = swaps(fish, ("mass = 0.086\n", '"mass" = 0.086\n'), (cut(fish, "[[fin]]", "[servo]"), ""))
    torque = "parameters.torque = { value = 0.081, low = 0.074, high = 0.089 }"
    return {
        "lines_end_as_on_windows": fish.replace("\n", "\r\n"),
        "byte_order_mark_of_an_editor": "\ufeff" + fish,
        "only_what_must_be_there": SMALL,
        "schema_left_out": swap(fish, 'schema = "fishmj.fish/1"\n', ""),
        "whole_numbers": swaps(
            fish,
            ("density_water = 1000.0", "density_water = 1000"),
            ("kp = 8.0  ", "kp = 8  "),
            ("range_deg = 60.0", "range_deg = 60"),
            ("stall_lag = 3.0 ", "stall_lag = 3 "),
        ),
        "numbers_in_other_writings": swaps(
            fish,
            ("density_water = 1000.0", "density_water = 1_000.0"),
            ("physics_dt = 0.004", "physics_dt = 4e-3"),
            ("stations = 6 ", "stations = 0x6 "),
            ("kp = 8.0  ", "kp = +8.0  "),
        ),
        "blocks_in_another_order": swap(rest, "[body]", water + "\n" + timing + servo + "[body]"),
        "title_with_umlauts_and_a_fish": swap(fish, "SWiFT fish, 4 links", "Pr\u00fcfstand \u2013 \u9b5a \U0001f41f"),
        "title_that_looks_like_a_page": swap(fish, "SWiFT fish, 4 links", "<b>SWiFT</b> & co, 4 links"),
        "notes_of_every_kind": fish + '\n[notes]\nbuilt = 2026-06-03\n"weighed with" = ["kitchen scales", 1, { by = "Jo" }]\n'
        "battery = nan\n[notes.pool]\ndepth = 1.2\n",
        "quoted_keys_and_an_inline_block": inline.replace("[body]\n", side + "\n\n[body]\n", 1),
        "angles_in_rad": swaps(
            fish,
            ("range_deg = 60.0", "range = 1.0472"),
            ("resolution_deg = 0.24 ", "resolution = 0.004189 "),
            ("stall_angle_deg = 35.0", "stall_angle = 0.61087"),
            ("stall_width_deg = 6.0", "stall_width = 0.10472"),
        ),
        "no_latency_at_all": swaps(
            fish, ("command_latency = 0.060", "command_latency = 0"), ("camera_latency = 0.065", "camera_latency = 0.0")
        ),
        "radio_of_half_a_second": swap(fish, "command_latency = 0.060", "command_latency = 0.5"),
        "no_fins_no_ballast": swap(swap(fish, cut(fish, "[[fin]]", "[servo]"), ""), "com = [0.12076, 0.0, -0.020]", "#"),
        "motor_of_another_make": swap(fish, "resistance = 6.27 ", "resistance = 0.9 "),
        "camera_of_a_second_ago": swap(fish, "camera_latency = 0.065", "camera_latency = 1.0"),
        "total_rounded_to_a_gram": swap(fish, "mass = 0.744", "mass = 0.74412"),
        "effect_as_a_bare_number": fish + effect("coulomb_friction", "parameters.torque = 0.081"),
        "effect_that_was_measured": fish + effect("coulomb_friction", torque),
        "section_too_wide": swap(fish, "[0.14, 0.094, 0.062]", "[0.14, 0.094, 0.120]"),
        "side_fin_on_the_left_only": swap(fish, "count = 2", "count = 1"),
        "no_line_end_at_the_end": fish.rstrip(),
        "names_that_are_words_of_the_format": swaps(
            fish, ('name = "body1"', 'name = "link"'), ('name = "body2"', 'name = "servo"')
        ),
        "nearly_a_megabyte_of_notes": fish + "\n" + 12_000 * ("# " + 70 * "." + "\n"),
    }
