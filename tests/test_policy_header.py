"""A policy's header names robot, structure, observation and command path; another is refused, a hostile one is one line."""

import copy
import json
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from policy_files import ROBOT, SHORT, arrays, header, stored

from fishmj import control
from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import ConfigError, FishmjError, StoreError
from fishmj.base.store import write_tensors
from fishmj.control.learned import LearnedController
from fishmj.control.policy import Policy
from fishmj.control.policy_meta import structure_sha256
from fishmj.deploy.commands.swim_command import main as swim
from fishmj.deploy.commands.trials_command import main as trials
from fishmj.evaluate.__main__ import main as evaluate
from fishmj.log import read_trial
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.identity import constants_sha256, observation_of, structure_of
from fishmj.mjcf.reading import load_robot
from fishmj.view.play.__main__ import main as play
from fishmj.water.choice import in_water
from fishmj.water.hydro_model import HydroModel

EVIL_COMMAND = "fishmj train --out '</script><script>alert(1)</script><img src=x onerror=alert(1)>'"


def longer(factor: float):
    """The fish with a longer head."""
    head = ROBOT.links[0]
    sections = tuple((s * factor, *rest) for s, *rest in head.sections)
    return replace(ROBOT, links=(replace(head, length=head.length * factor, sections=sections), *ROBOT.links[1:]))


def heavy_head(factor: float):
    """The fish with a heavier head: its reference point, the centre of mass, is nearer to the nose."""
    head = ROBOT.links[0]
    return replace(ROBOT, links=(replace(head, mass=head.mass * factor), *ROBOT.links[1:]))


# which robot


def test_training_writes_the_whole_header():
    from fishmj.train.build import policy_of
    from fishmj.train.learner import PolicyLayers
    from fishmj.train.settings import preset

    network = PolicyLayers([(np.zeros((11, 4)), np.zeros(4)), (np.zeros((4, 3)), np.zeros(3))], "tanh")
    meta = policy_of(network, replace(preset("quick"), water="swift"), {}).meta
    assert meta["structure_sha256"] == structure_sha256(meta["structure"]) and meta["constants_sha256"] == constants_sha256(ROBOT)
    assert meta["structure"]["reference_point"] == round(geometry_of(ROBOT).reference, 6)
    assert meta["water"] == {"name": "swift", "kind": "fitted", "sha256": HydroModel.load("swift").sha256}
    assert meta["water"] == Policy.load("station").meta["water"]
    assert meta["command"] is None and meta["seed"] == 0, "called from Python"
    assert meta["structure"] == structure_of(ROBOT) and meta["observation"] == observation_of(3)
    assert (
        meta["robot"] == "swift" and meta["command_path"] == "linear" and meta["control_dt"] == 0.2 and len(meta["scale"]) == 11
    )
    assert [row["name"] for row in meta["observation"]][:6] == [
        "target_x",
        "target_y",
        "velocity_x",
        "velocity_y",
        "yaw_rate",
        "j1",
    ]


def test_the_robot_of_the_header_is_taken_without_a_word(tmp_path):
    assert control.make(stored(tmp_path, header()), ROBOT).notes == ()


@pytest.mark.parametrize("water", ["family", "swift", "swift-reference-b", "swift-slip095"])
def test_a_member_of_the_family_of_the_training_is_taken_without_a_word(water):
    assert control.make("station-family", in_water(load_robot("fish"), water)).notes == ()


@pytest.mark.parametrize("water", ["structured", "swift-base", "swift#2", "swift-reference"])
def test_a_water_outside_the_family_of_the_training_is_noted(tmp_path, water):
    (note,) = control.make("station-family", robot := in_water(load_robot("fish"), water)).notes
    assert f"not as trained: water swift-family, here {water.replace('#', '.')}" in note
    foreign = header() | {"water": {"name": "swift-family", "kind": "family", "sha256": "0" * 64}}  # another one of that name
    assert "not as trained: water" in control.make(stored(tmp_path, foreign), robot).notes[0]


def test_a_calibrated_fish_of_another_name_is_taken_with_a_note(tmp_path):
    links = tuple(replace(link, mass=1.1 * link.mass) for link in longer(1.05).links)
    robot = replace(ROBOT, name="swift.v2", links=links, servo=replace(ROBOT.servo, kp=9.0))
    (note,) = control.make(stored(tmp_path, header()), robot).notes
    assert note == (
        "policy mine: not as trained: robot swift, here swift.v2; lengths or reference point off by at most 10 %; "
        "mass of head 0.744, here 0.8184; mass of body1 0.168, here 0.1848; mass of body2 0.102, here 0.1122; "
        "mass of tail 0.086, here 0.0946; servo kp 8, here 9"
    )


@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_a_tenth_of_a_length_is_taken(tmp_path, scale):
    """The length in training is the measure: a tail that is a tenth shorter has nine tenths of it."""
    (note,) = control.make(stored(tmp_path, header()), longer(scale)).notes
    assert "off by at most 10 %" in note


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        (longer(1.2), "made for a head of 0.215 m, the robot's is 0.258 m"),
        (replace(ROBOT, servo=replace(ROBOT.servo, range=0.8)), "made for servos of +-60 deg, the robot's have +-45.8 deg"),
        (
            replace(ROBOT, links=(ROBOT.links[0], ROBOT.links[2], ROBOT.links[1], ROBOT.links[3])),
            "4 links (head, body1, body2, tail), the robot has 4 links (head, body2, body1, tail)",
        ),
        (replace(ROBOT, timing=replace(ROBOT.timing, control_dt=0.1)), "decides every 0.2 s, the robot every 0.1 s"),
        (heavy_head(4.0), "made for a reference point 0.182 m behind the nose, the robot's is 0.141 m"),
        (load_robot("tendon_fish"), "has 11 observations and 3 actions; robot tendon_fish needs 9 and 2"),
    ],
)
@pytest.mark.parametrize("anyway", [False, True])
@pytest.mark.parametrize("name", ["mine", "paper", "station"])
def test_another_structure_or_order_is_refused_with_both(tmp_path, robot, said, name, anyway):
    """Of the shipped `paper`, whose header is older, the structure of the robot that it names is known."""
    source = stored(tmp_path, header()) if name == "mine" else name
    with pytest.raises(ConfigError) as caught:
        control.make(source, robot, anyway=anyway)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_policy_of_another_robot_names_the_robot_that_it_was_trained_for():
    with pytest.raises(ConfigError, match="it was trained for 'swift'.* in simulations the controller dob"):
        control.make("station", load_robot("tendon_fish"))


def test_a_structure_that_is_only_named_by_its_hash_is_compared(tmp_path):
    bare = header(structure=None, structure_sha256=structure_sha256(structure_of(ROBOT)))
    assert control.make(stored(tmp_path, bare), ROBOT).notes == ()
    with pytest.raises(ConfigError, match="made for structure 882f7f326eef, the robot's is"):
        control.make(stored(tmp_path, bare), longer(1.01), anyway=True)


@pytest.mark.parametrize("anyway", [False, True])
def test_other_observations_are_refused(tmp_path, anyway):
    rows = observation_of(3)
    rows[0], rows[1] = rows[1], rows[0]
    with pytest.raises(ConfigError, match=r"sees target_y \[m\], target_x \[m\], .*; the robot gives target_x \[m\], target_y"):
        control.make(stored(tmp_path, header(observation=rows)), ROBOT, anyway=anyway)


def test_an_older_header_is_read_by_rule_and_what_it_does_not_say_is_said(tmp_path):
    new = ("structure", "structure_sha256", "constants_sha256", "water", "command")
    old = {k: v for k, v in header(robot="another").items() if k not in new} | {"observation": "target_x .., SI"}
    lacks = "links, reference point, constants, water, observations, training command"
    _, said = control.make(stored(tmp_path, old), ROBOT).notes
    assert said == f"policy mine: its header lacks {lacks}, not compared"
    with pytest.raises(ConfigError, match="made for servos of"):
        control.make(stored(tmp_path, old), replace(ROBOT, servo=replace(ROBOT.servo, range=0.8)))
    bare = {key: old[key] for key in ("schema", "scale", "activation")}
    (note,) = control.make(stored(tmp_path, bare), ROBOT).notes
    assert "lacks robot, links, reference point, constants, water, command path, observations, seed, training" in note
    four = header(structure={k: v for k, v in structure_of(ROBOT).items() if k != "reference_point"}, robot="another")
    _, note = control.make(stored(tmp_path, four), ROBOT).notes
    assert "lacks reference point," in note, "as the version before this one wrote it"


# command path

HELD = replace(ROBOT, timing=replace(ROBOT.timing, command_path="hold"))


@pytest.fixture
def held_fish(tmp_path):
    """The description of the fish on another command path."""
    text, path = (calib_folder() / "fish.toml").read_text(encoding="utf-8"), tmp_path / "held.toml"
    head, _, rest = text.partition("[timing]\n")
    lines = [line for line in rest.splitlines() if not line.startswith("command_path")]
    path.write_text("\n".join([f'{head}[timing]\ncommand_path = "hold"', *lines]), encoding="utf-8")
    return path


def test_another_command_path_is_refused_unless_it_was_asked_for():
    with pytest.raises(ConfigError, match="trained on command path linear, the robot's is hold: put command_path"):
        control.make("paper", HELD)
    (note,) = control.make("paper", HELD, anyway=True).notes
    assert note == "policy paper: not as trained: command path linear, here hold"


@pytest.mark.parametrize(
    ("main", "words", "options"),
    [
        (evaluate, ["paper"], {"--robot", "--anyway", "--command-path"}),
        (play, ["--controller", "paper"], {"--robot", "--anyway"}),
        (swim, ["--policy", "paper"], {"--robot", "--anyway"}),
        (trials, ["--policy", "paper", "--out", "new"], {"--robot", "--anyway"}),
    ],
)
def test_a_refused_policy_is_answered_with_options_of_the_command(main, words, options, held_fish, capsys, monkeypatch):
    monkeypatch.chdir(held_fish.parent)
    assert console.run(main, [*words, "--robot", held_fish.name]) == console.BAD_INPUT
    said = capsys.readouterr().err
    assert 'the robot\'s is hold: put command_path = "linear" into [timing] of its description' in said
    assert set(re.findall(r"--[a-z-]+", said.partition("in simulations")[0])) == options


def test_a_command_path_on_the_command_line_is_no_consent(capsys):
    assert console.run(evaluate, ["paper", "--command-path", "hold", *SHORT]) == console.BAD_INPUT
    assert "add --anyway" in capsys.readouterr().err
    assert console.run(evaluate, ["paper", "--command-path", "hold", "--anyway", *SHORT]) == console.OK
    assert capsys.readouterr().err.count("not as trained: command path linear, here hold") == 1


def test_a_description_with_another_command_path_is_no_consent(held_fish, capsys):
    argv = ["paper", "--robot", str(held_fish), *SHORT]
    assert console.run(evaluate, argv) == console.BAD_INPUT
    assert "the robot's is hold" in capsys.readouterr().err
    assert console.run(evaluate, [*argv, "--anyway"]) == console.OK


# hostile files

BAD = [
    ({"memory": 0}, "memory 0"),
    ({"memory": True}, "memory True"),
    ({"memory": 10**9}, "memory 1000000000"),
    ({"memory": [1]}, "memory [1]"),
    ({"scale": ["1"] * 11}, "scale ['1'"),
    ({"scale": [float("nan")] * 11}, "scale [nan"),
    ({"scale": [float("inf")] * 11}, "scale [inf"),
    ({"scale": [True] * 11}, "scale [True"),
    ({"scale": [10**400] * 11}, "scale [1"),
    ({"scale": [1.0] * 100_000}, "scale a list of 100000"),
    ({"scale": {"0": 1.0}}, "scale {"),
    ({"activation": ["relu"]}, "activation ['relu']"),
    ({"activation": {"relu": 1}}, "activation {'relu': 1}"),
    ({"activation": "<b>" * 1000}, "activation '<b>"),
    ({"robot": "<script>alert(1)</script>"}, "robot '<script>"),
    ({"robot": "../../etc/passwd"}, "robot '../../etc/passwd'"),
    ({"robot": "a\nb"}, "robot 'a\\nb'"),
    ({"robot": ["swift"]}, "robot ['swift']"),
    ({"name": "x\x00y"}, "name 'x\\x00y'"),
    ({"name": "a/b"}, "name 'a/b'"),
    ({"command_path": 3}, "command_path 3"),
    ({"command_path": "lin\near"}, "command_path 'lin\\near'"),
    ({"control_dt": float("nan")}, "control_dt nan"),
    ({"control_dt": 0}, "control_dt 0"),
    ({"joints": "three"}, "joints 'three'"),
    ({"joints": 10**9}, "joints 1000000000"),
    ({"structure": "fish"}, "structure 'fish'"),
    ({"structure": {"links": []}}, "structure {'links': []}"),
    ({"structure": structure_of(ROBOT) | {"lengths": [0.1, "x", 0.1, 0.1]}}, "expected names, positive lengths"),
    ({"structure": structure_of(ROBOT) | {"lengths": [float("inf")] * 4}}, "expected names, positive lengths"),
    ({"structure": structure_of(ROBOT) | {"lengths": [0.1]}}, "4 links, 1 lengths and 3 joints"),
    ({"structure": structure_of(ROBOT) | {"links": ["a", "b<", "c", "d"]}}, "expected names"),
    ({"observation": [{"name": "x", "unit": "m"}]}, "observation [{'name': 'x', 'unit': 'm'}]; expected 11 rows"),
    ({"observation": [3] * 11}, "observation [3"),
    ({"observation": "x" * 100_000}, "observation 'xxx"),
    ({"algorithm": "<img>"}, "algorithm '<img>'"),
    ({"structure_sha256": "0" * 64}, "structure_sha256 is not the hash of structure"),
    ({"structure_sha256": "<b>"}, "structure_sha256 '<b>'; expected 64 hex digits"),
    ({"constants_sha256": ["0" * 64]}, "constants_sha256 ['000"),
    ({"structure": structure_of(ROBOT) | {"reference_point": -1}}, "a reference point in m"),
    ({"structure": structure_of(ROBOT) | {"more": 1}}, "expected links, lengths, joints, servo_range, reference_point"),
    ({"water": "swift"}, "water 'swift'; expected {name, kind}"),
    ({"water": {"name": "<b>", "kind": "fitted"}}, "water {'name': '<b>'"),
    ({"water": {"name": "swift", "kind": "a b"}}, "'kind': 'a b'"),
    ({"water": {"name": "swift", "kind": "fitted", "sha256": 3}}, "'sha256': 3}"),
    ({"water": {"name": "swift", "kind": "fitted", "more": 3}}, "'more': 3}"),
    ({"command": "a\nb"}, "command 'a\\nb'; expected one line"),
    ({"command": "x" * 5000}, "command 'xxx"),
    ({"command": ["fishmj"]}, "command ['fishmj']"),
]


@pytest.mark.parametrize(("change", "said"), BAD, ids=[said[:24].replace("\n", " ") for _, said in BAD])
def test_a_bad_key_is_one_short_line_with_the_file(tmp_path, change, said):
    path = stored(tmp_path, header(**change))
    with pytest.raises(ConfigError) as caught:
        Policy.load(path)
    text = str(caught.value)
    assert path in text and said in text and "\n" not in text and "<script>" not in text.replace(repr(change.get("robot")), "")
    assert len(text) < 400


def test_a_hostile_command_is_text_on_every_page(tmp_path):
    """The one key that is free text; page and log hold it as text, the terminal not at all."""
    brain = LearnedController(replace(ROBOT, name="x"), stored(tmp_path, header(command=EVIL_COMMAND)))
    assert brain.trained()["command"] == EVIL_COMMAND and EVIL_COMMAND not in " ".join(brain.notes)
    argv = [stored(tmp_path, header(command=EVIL_COMMAND, water={"name": "x", "kind": "y"})), *SHORT, "--log", "--out"]
    assert console.run(evaluate, [*argv, str(tmp_path / "out")]) == console.OK
    for page in ("report.html", "worst.html"):
        text = (tmp_path / "out" / page).read_text(encoding="utf-8")
        assert "<script>alert(1)" not in text and "<img src=x" not in text
    assert "water x, here structured" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert read_trial(tmp_path / "out" / "logs" / "mine_u0.2_los000_r0").value("policy.command") == EVIL_COMMAND


def test_memory_null_is_no_memory(tmp_path):
    policy = Policy.load(stored(tmp_path, header(memory=None)))
    assert policy.memory == 1 and policy(np.zeros((2, 11))).shape == (2, 3)


@pytest.mark.parametrize("meta", [[], "policy", 3, None, [[[]]]])
def test_a_header_that_is_no_table_is_refused(tmp_path, meta):
    with pytest.raises(FishmjError, match="schema|header"):
        Policy.load(stored(tmp_path, meta))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a.update(w0=a["w0"].astype(np.int32)), "weights are not floating-point numbers"),
        (lambda a: a.update(w0=np.zeros((0, 11), np.float32), b0=np.zeros(0, np.float32)), "layer 0 has weights (0, 11)"),
        (lambda a: a.update(w1=np.zeros((8, 8, 8), np.float32)), "layer 1 has weights (8, 8, 8)"),
        (lambda a: a.update(b1=np.float32(1.0)), "layer 1 has weights (3, 8) and bias ()"),
        (lambda a: a.update({f"x{i}": np.zeros(1) for i in range(500)}), "expected w0, b0"),
    ],
)
def test_arrays_that_are_no_layers_are_one_short_line(tmp_path, change, said):
    some = arrays()
    change(some)
    with pytest.raises(ConfigError) as caught:
        Policy.load(stored(tmp_path, header(), some))
    assert said in str(caught.value) and len(str(caught.value)) < 500


def raw(path, table: dict, data: bytes = b""):
    """A safetensors file by hand."""
    text = json.dumps(table).encode()
    (path / "raw.safetensors").write_bytes(struct.pack("<Q", len(text)) + text + data)
    return path / "raw.safetensors"


@pytest.mark.parametrize(
    "entry",
    [
        {"dtype": "F32", "shape": [10**9, 10**9], "data_offsets": [0, 4]},
        {"dtype": "F32", "shape": [1], "data_offsets": [0, 2**62]},
        {"dtype": "F32", "shape": [-1], "data_offsets": [0, 4]},
        {"dtype": "F999", "shape": [1], "data_offsets": [0, 4]},
        {"dtype": "BF16", "shape": [2], "data_offsets": [0, 4]},
    ],
)
def test_false_tensor_shape_in_a_policy_file_is_refused(tmp_path, entry):
    table = {"w0": entry, "__metadata__": {"fishmj": json.dumps(header()), "sha256": "0" * 64}}
    with pytest.raises(StoreError):
        Policy.load(raw(tmp_path, table, b"\0" * 4))


def test_a_header_nested_without_end_is_refused(tmp_path):
    import hashlib

    deep = "[" * 100_000 + "]" * 100_000
    table = {"__metadata__": {"fishmj": deep, "sha256": hashlib.sha256(deep.encode()).hexdigest()}}
    with pytest.raises(StoreError, match="damaged or not a fishmj tensor file"):
        Policy.load(raw(tmp_path, table))


def test_weights_too_large_to_multiply_are_one_line(tmp_path):
    some = {k: np.full_like(v, 1e200, dtype=np.float64) * (1 if k[0] == "w" else 0) for k, v in arrays().items()}
    some["w1"][:, ::2] *= -1
    brain = LearnedController(ROBOT, stored(tmp_path, header(), some))
    brain.reset(1)
    with np.errstate(all="ignore"), pytest.raises(ConfigError, match="its action is not finite"):
        brain(np.ones((1, 11)))


def test_a_file_name_that_is_no_name_is_cleaned_for_reports(tmp_path):
    path = tmp_path / "<b>my policy&.safetensors"
    write_tensors(path, arrays(), header())
    assert control.make(str(path), ROBOT).name == "b_my_policy"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
KEYS = sorted(set(header()) - {"schema"})


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.dictionaries(st.sampled_from(KEYS), JSON, min_size=1, max_size=3), st.sampled_from([None, "structure"]), JSON)
def test_any_header_is_either_a_controller_or_one_line(changes, part, value):
    """Generated values under the known keys, and inside the structure: a controller or a FishmjError, nothing else."""
    meta = copy.deepcopy(header(**changes))
    if part and isinstance(meta.get(part), dict):
        meta[part][sorted(meta[part])[0] if meta[part] else "links"] = value
    policy = Policy([(arrays()[f"w{i}"], arrays()[f"b{i}"]) for i in range(2)], meta)
    try:
        policy.check("generated")
        policy.reset(1)
        assert policy(np.zeros((1, 11))).shape == (1, 3)
        from fishmj.control.learned import body_of
        from fishmj.control.policy_meta import fit

        assert all("\n" not in note for note in fit(policy.meta, body_of(ROBOT), anyway=False, known={}).notes)
    except FishmjError as error:
        assert "\n" not in str(error) and len(str(error)) < 1200
