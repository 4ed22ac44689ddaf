"""Code of the user's own: what they typed is found and run, a broken interface is one line, text from a file never runs."""

import importlib
import importlib.metadata
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typed import EXAMPLE, refused, write

from fishmj import control, effects, suite
from fishmj.base import console, plugins
from fishmj.base.errors import ConfigError, FishmjError, OwnCodeError, UnknownName
from fishmj.effects import Effect, Parameter
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.engines import own_effects, with_effects
from fishmj.evaluate.__main__ import main as evaluate
from fishmj.gap.commands.plant import main as plant
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.log import read_trial, write_dataset
from fishmj.mjcf.reading import load_robot
from fishmj.tasks.episode import TaskOptions, TaskSpec
from fishmj.tasks.reference import EpisodeStart, course_of
from fishmj.tasks.station_hold import draw_start

ROOT = Path(__file__).resolve().parent.parent
SHORT = ["--speeds", "0.2", "--los", "0", "--repeats", "1", "--duration", "1"]
PARTS = ("controller", "task", "effect", "algorithm", "importer")


# the loader


def test_a_module_in_the_working_folder_and_a_file_are_found(tmp_path, monkeypatch):
    write(tmp_path, "class A:\n    pass\nclass B:\n    class C:\n        pass\n", "found_here_1.py")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert plugins.load("task", "found_here_1:A").__name__ == "A"
    assert plugins.load("task", "./found_here_1.py:B.C").__name__ == "C"
    assert plugins.load("task", "found_here_1:A") is plugins.loaded("task")["found_here_1:A"]


@pytest.mark.parametrize(
    ("reference", "said"),
    [
        ("no_such_module_1:X", "no module 'no_such_module_1' in Python's path or in"),
        ("json.no_such_part:X", "no module 'json.no_such_part'"),
        ("json:dump_s", "did you mean 'dumps'"),
        ("./nowhere.py:X", "nowhere.py: no such file"),
        ("mine.py", "expected package.module:Name or path/to/file.py:Name"),
        ("os.system('echo'):x", "expected package.module:Name"),
        ("a/b:X", "expected package.module:Name"),
    ],
)
def test_a_reference_that_leads_nowhere_is_one_line(reference, said):
    with pytest.raises(OwnCodeError, match=re.escape(said)) as caught:
        plugins.load("controller", reference)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("x = 1\ny = x / 0\n", 2, "ZeroDivisionError: division by zero"),
        ("import no_such_package_2\n", 1, "No module named 'no_such_package_2'"),
        ("def f(:\n    pass\n", 1, "SyntaxError"),
        ("import sys\nsys.exit(3)\n", 2, "SystemExit: 3"),
        ("raise ValueError('a\\nb')\n", 1, "ValueError: a b"),
    ],
)
def test_an_error_while_importing_names_the_users_file_and_line(tmp_path, text, line, said):
    path = write(tmp_path, text)
    with pytest.raises(OwnCodeError, match=re.escape(f"{path}:{line}: ")) as caught:
        plugins.load("controller", f"{path}:X")
    assert said in str(caught.value) and "\n" not in str(caught.value) and "FISHMJ_TRACEBACK" in str(caught.value)


def test_the_whole_traceback_is_shown_on_request(tmp_path, monkeypatch, capsys):
    path = write(tmp_path, "def deep():\n    return {}['key']\ndeep()\n")
    assert console.run(lambda argv: plugins.load("task", f"{path}:X"), []) == console.BAD_INPUT
    assert "Traceback" not in capsys.readouterr().err
    monkeypatch.setenv("FISHMJ_TRACEBACK", "1")
    assert console.run(lambda argv: plugins.load("task", f"{path}:X"), []) == console.BAD_INPUT
    assert "in deep" in capsys.readouterr().err


def installed(folder: Path, group: str, entry: str) -> None:
    """A distribution in a folder, as pip would leave it."""
    info = folder / "own_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-package\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[{group}]\n{entry}\n", encoding="utf-8")


def test_entry_point_is_found_by_name_without_importing_it(tmp_path, monkeypatch):
    write(tmp_path, "class Steer:\n    def __init__(self, robot): pass\n", "own_package_3.py")
    installed(tmp_path, "fishmj.controllers", "steer = own_package_3:Steer\nbad name! = own_package_3:Steer")
    monkeypatch.syspath_prepend(tmp_path)
    assert plugins.listed("controller") == ["steer"] and plugins.listed("task") == []
    assert "own_package_3" not in sys.modules
    with pytest.raises(UnknownName, match="Did you mean 'steer'"):
        control.chosen("steeer")
    with pytest.raises(UnknownName):
        control.make("steer")
    assert plugins.load("controller", "steer").__name__ == "Steer"
    assert importlib.metadata.version("own-package") == "1.0"


def test_text_that_may_come_from_a_file_is_never_loaded(tmp_path):
    """`make`, `get`, `TaskSpec`, `Options` and `change` take names from files; none of them runs a reference."""
    from fishmj.tasks.env import Options, StationHold
    from fishmj.train.settings import change, preset

    ran = str(tmp_path / "ran")
    reference = f"{write(tmp_path, f'X = open({ran!r}, 1)')}:X"
    for take in (
        lambda: control.make(reference),
        lambda: effects.get(reference),
        lambda: with_effects(load_robot("fish"), [reference]),
        lambda: TaskSpec(reference, TaskOptions()),
        lambda: StationHold(load_robot("fish"), "planar", Options(course=reference)),
        lambda: change(preset("quick"), algo=reference),
    ):
        with pytest.raises(FishmjError):
            take()
    assert not (tmp_path / "ran").exists()


# controllers


def test_an_own_controller_is_judged_reported_logged_and_replayed(tmp_path, capsys):
    out = tmp_path / "report"
    assert console.run(evaluate, [f"{EXAMPLE}:Chase", "drift", *SHORT, "--out", str(out), "--log", "--json"]) == console.OK
    found = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert [r["controller"] for r in found["results"]] == ["chase", "drift"]
    assert "chase" in (out / "report.html").read_text() and "chase," in (out / "trials.csv").read_text()
    (folder,) = (out / "logs").glob("chase_*")
    trial = read_trial(folder)
    assert trial.value("controller") == "chase" and trial.value("policy_sha256") == plugins.source_sha256(
        plugins.load("controller", f"{EXAMPLE}:Chase")
    )
    from fishmj.view.replay.__main__ import main as replay

    assert console.run(replay, [str(folder), "--out", str(tmp_path / "replay.html")]) == console.OK
    assert "chase" in (tmp_path / "replay.html").read_text()


HEAD = """import numpy as np
class C:
    def __init__(self, robot): pass
    def reset(self, n): self.n = n
    def __call__(self, obs): """


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            HEAD + "return np.zeros((self.n, 3))",
            "control step 0: returned an array of shape (1, 3); expected bus commands (1, 10, 3)",
        ),
        (HEAD + "return np.full((self.n, 10, 3), np.nan)", "returned 30 values that are not finite"),
        (HEAD + "return np.full((self.n, 10, 3), 30.0)", "returned a command of 30; expected"),
        (HEAD + "return 'left'", "returned a str, not an array of numbers"),
        (HEAD + "return obs[0, 99]", "mine.py:5: IndexError"),
        (HEAD + "return 1 / 0", "mine.py:5: ZeroDivisionError"),
        ("class C:\n    def __init__(self, robot): raise KeyError('gain')", "mine.py:2: KeyError: 'gain'"),
        ("class C:\n    def __init__(self): pass", "expected Name(robot), got Name()"),
        ("class C:\n    def __init__(self, robot): pass", "has no reset(n)"),
        (
            "class C:\n    def __init__(self, robot): pass\n    def reset(self): pass\n    def __call__(self, o): pass",
            "expected reset(n)",
        ),
        (
            "class C:\n    def __init__(self, robot): pass\n    def reset(self, n): pass\n    def __call__(self): pass",
            "__call__(obs)",
        ),
        ("C = 3", "has no Name(robot)"),
    ],
)
def test_a_wrong_controller_is_one_line_at_its_first_step(tmp_path, capsys, text, said):
    assert said in refused(evaluate, [f"{write(tmp_path, text)}:C", *SHORT], capsys)


def test_an_own_controller_cannot_take_a_shipped_name_or_leave_the_folder(tmp_path):
    body = (
        HEAD
        + "return np.zeros((len(obs), 10, 3))\nclass A(C): name = 'pd'\nclass B(C): name = '../../x y'\nclass D(C): name = 7\n"
    )
    path = write(tmp_path, body)
    names = [control.chosen(f"{path}:{c}").name for c in "ABCD"]
    assert names == ["mine.A", "x_y", "mine.C", "7"]


def test_two_controllers_of_one_name_keep_their_files_apart():
    assert [b.name for b in control.several(["pd", "drift", "pd"])] == ["pd", "drift", "pd-2"]


# tasks


@pytest.fixture
def line():
    return plugins.load("task", f"{EXAMPLE}:LineFollow")


def test_an_own_task_loads_in_gymnasium_and_dm_control_with_its_options(line):
    import gymnasium

    env = gymnasium.make("fishmj.tasks.gym:fishmj/StationHold-v0", task=f"{EXAMPLE}:LineFollow", speed=0.1, engine="batch")
    env.reset(seed=1)
    assert env.unwrapped.rules.name in ("own_code.LineFollow", "LineFollow")
    before = env.unwrapped.episodes.target.copy()
    _, reward, terminated, truncated, info = env.step(np.zeros(3))
    np.testing.assert_allclose(env.unwrapped.episodes.target - before, [[0.1 * 0.2, 0.0]], atol=1e-9)
    assert env.unwrapped.rules.limit == 50 and reward < 0.5 and not terminated and not truncated and info["distance"] < 0.5
    timed = suite.load("fish", f"{EXAMPLE}:LineFollow", task_kwargs={"random": 1, "speed": 0.1})
    timed.reset()
    step = timed.step(np.zeros(3))
    expected = min(timed.task.trace.velocity[0, :, 0].mean() / 0.1, 1.0) - 2.0 * abs(timed.task.window.pose[0, -1, 1])
    assert step.reward == pytest.approx(expected)
    with pytest.raises(ConfigError, match="unknown option 'sped'"):
        suite.load("fish", line, task_kwargs={"sped": 0.1})


def test_an_own_reward_takes_no_weights_of_the_papers(line):
    with pytest.raises(ConfigError, match="has its own reward, without weights wS"):
        TaskSpec(line, TaskOptions(wS=0.1))


class Good:
    """The least that is a task."""

    seconds = 2.0

    def launch(self, xp, uniforms):
        return EpisodeStart(draw_start(xp, uniforms), 0.0 * uniforms[:, 0])

    def target(self, xp, launch, t):
        return launch.start.target + 0.0 * t[:, None]


def test_a_task_without_reward_and_end_has_the_papers():
    rules = TaskSpec(Good, TaskOptions())
    assert rules.course.reward is None and rules.limit == 10 and rules.name == "Good"
    assert rules.outside(np, np.array([[2.1, 0.0, 0.0], [1.9, 0.0, 0.0]])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"launch": lambda self, xp, u: Good.launch(self, xp, u)._replace(seconds=3.0 + u[:, 0])}, "at most the task's 2 s"),
        ({"launch": None}, "has no launch(xp, uniforms)"),
        ({"launch": lambda self, xp: None}, "expected launch(xp, uniforms)"),
        ({"launch": lambda self, xp, u: u}, "launch returned ndarray; expected EpisodeStart"),
        ({"launch": lambda self, xp, u: EpisodeStart(draw_start(xp, u), u)}, "launch: phase has shape (5, 7), expected (5,)"),
        ({"target": lambda self, xp, launch, t: launch.start.target[0]}, "target has shape (2,), expected (5, 2)"),
        ({"target": lambda self, xp, launch, t: launch.start.target / 0.0}, "target is not finite"),
        ({"target": lambda self, xp, launch, t: launch.nothing}, "AttributeError"),
        ({"reward": lambda self, xp, step: 1.0}, "reward has shape None, expected (5,)"),
        ({"reward": lambda self, xp, step: step.trace.rate}, "reward has shape (5, 10, 3)"),
        ({"outside": lambda self, xp, pose: pose[..., 0]}, "outside returned float64; expected bool"),
        ({"seconds": -1}, "seconds = -1"),
        ({"seconds": "10"}, "seconds = '10'"),
        ({"observe": lambda self, xp, step: step.distance}, "has observe, which is never called: policies see fishmj's 5 + 2 J"),
        ({"observation_space": 3}, "has observation_space, which is never called"),
    ],
)
def test_a_wrong_task_is_one_line_before_anything_runs(change, said):
    with np.errstate(all="ignore"), pytest.raises(OwnCodeError, match=re.escape(said)):
        course_of(type("Wrong", (Good,), change))


def test_the_own_task_is_one_definition_for_numpy_and_jax(line):
    import jax
    import jax.numpy as jnp

    course, u = course_of(line), np.random.default_rng(2).random((6, 7)).astype(np.float32)
    with jax.enable_x64(False):
        for a, b in zip(jax.tree.leaves(course.launch(np, u)), jax.tree.leaves(course.launch(jnp, jnp.asarray(u))), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6)


# training: own task and own algorithm together


@pytest.mark.slow
def test_an_own_task_and_algorithm_train_to_a_policy_file(tmp_path):
    from fishmj.control.policy import Policy
    from fishmj.train.__main__ import options, settings_from
    from fishmj.train.build import algorithm, environment
    from fishmj.train.settings import change
    from fishmj.train.training_run import TrainingRun

    line_ = ["--task", f"{EXAMPLE}:LineFollow", "--algo", f"{EXAMPLE}:Evolution", "--engine", "compiled", "--envs", "8"]
    settings = settings_from(options().parse_args([*line_, "--steps", "400", "--preset", "quick"]))
    settings = change(settings, assess_episodes=4, assess_every=400, algorithm={"horizon": 25})
    env = environment(settings)
    figures = {"return": 1.0, "arrival": 0.5, "stayed": 1.0, "rmse_last10": 0.1}
    run = TrainingRun(settings, tmp_path / "run", quiet=True, learner=(env, algorithm(settings, env), lambda actor, key: figures))
    assert run.env.limit == 50 and run.env.moves
    first = run.training.env.target[:, 0]
    done = run.go()
    moved = np.asarray(run.training.env.target[:, 0] - first)
    assert (moved >= 0.0).all() and moved.max() > 0.3 and done["steps"] == 400 and done["tune_return"] == 1.0
    policy = Policy.load(done["policy"])
    assert policy.meta["algorithm"] == "own_code.Evolution" and policy.meta["structure"]["joints"] == ["j1", "j2", "j3"]
    assert control.make(done["policy"]).notes == ()
    again = TrainingRun(settings, tmp_path / "run", quiet=True, resume=True, learner=(run.env, run.algorithm, run.assess))
    assert again.done == 400


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"Config": None}, "has no Config"),
        ({"act": None}, "has no act(actor, obs)"),
        ({"act": lambda self, actor, obs: 0.5 * obs[:, :3]}, "act differs from the policy that would be written"),
        ({"policy_layers": lambda self, actor: (actor, "relu")}, "act differs from the policy that would be written"),
        ({"policy_layers": lambda self, actor: 3}, "init returned an unusable `actor`"),
        ({"init": lambda self, key: 3}, "init returned an unusable `actor`"),
        ({"iterate": lambda self, training: training}, "expected (training, metrics as a dict)"),
        ({"iterate": lambda self, training: (training, {"reward": 1.0})}, "its metrics lack late_distance, episodes, diverged"),
        ({"__init__": lambda self, env: None}, "expected Name(env, config, steps)"),
    ],
)
def test_a_wrong_algorithm_is_one_line_before_it_trains(monkeypatch, change, said):
    from types import SimpleNamespace

    import jax

    from fishmj.tasks.station_hold import input_scale
    from fishmj.train.build import algorithm
    from fishmj.train.settings import Settings
    from fishmj.train.settings import change as changed

    good = plugins.load("algorithm", f"{EXAMPLE}:Evolution")
    monkeypatch.setitem(plugins._LOADED["algorithm"], "wrong:Wrong", type("Wrong", (good,), change))
    settings = changed(Settings(algo="wrong:Wrong"), steps=100)
    env = SimpleNamespace(n_obs=11, n_act=3, n_input=11, input_scale=input_scale(3), reset=lambda key, n, stagger: key)
    with pytest.raises(OwnCodeError, match=re.escape(said)):
        learner = algorithm(settings, env)
        learner.iterate(learner.init(jax.random.key(0)))


# effects


def test_effects_of_the_catalogue_pass_the_check_of_own_effects():
    """One for each stage and each set of sites; `test_effects.py` looks at all of them."""
    lasting = [e for e in effects.catalogue().values() if not e.stochastic]
    kinds = {(e.stage, e.sites[:1]): e for e in lasting} | {e.sites: e for e in lasting}
    for effect in {e.name: e for e in kinds.values()}.values():
        own_effects.check(effect)


def test_an_effect_that_acts_on_a_fish_that_slows_down_alone_is_one():
    """A push ahead while the fish is slower than the mean of the last seconds: nothing to see in a first step."""

    def body(xp, p, b, memory, h):
        (mean,) = memory
        return b._replace(fx=b.fx + p.drag * xp.maximum(mean - b.u, 0.0)), (mean + h / 2.0 * (b.u - mean),)

    size = Parameter(name="drag", unit="N s/m", low=0.0, high=1.0, typical=(0.1, 0.5))
    own_effects.check(Effect(**GIVEN | {"parameters": (size,), "body": body, "memory": (0.0,)}))


def test_an_own_effect_joins_the_catalogue_and_acts_in_the_engines(catalogue):
    from fishmj.gap.models.swimming_fish import SwimmingFish
    from fishmj.sim import Sim

    (weed,) = own_effects.join([f"{EXAMPLE}:WEED"])
    assert effects.get("weed") is weed and own_effects.join([f"{EXAMPLE}:WEED"]) == [weed]
    robot = with_effects(load_robot("fish"), ["weed"])
    grown = type(robot)(**{**vars(robot), "effects": (FittedEffect("weed", {"drag": Interval(15.0, 15.0, 15.0)}),)})
    wave = lambda t: 0.4 * np.sin(2 * np.pi * t - np.array([0.0, 1.0, 2.0]))
    plain, null, slow = (Sim(r).run(wave, 3.0).table("truth")["x"] for r in (load_robot("fish"), robot, grown))
    np.testing.assert_allclose(null, plain, atol=1e-6)
    assert abs(slow[-1]) < 0.9 * abs(plain[-1])
    assert SwimmingFish("fish").index("weed", "drag") > 0  # what the search questions


GIVEN = {
    "name": "mine", "stage": "hydrodynamics", "about": "a", "formula": "f", "source": "s", "shows": ("position",),
    "parameters": (Parameter(name="size", unit="N", low=0.0, high=10.0, typical=(0.5, 2.0)),),
}  # fmt: skip


def add(amount):
    """A force ahead on the body."""
    return lambda xp, p, body, memory, h: (body._replace(fx=body.fx + amount(xp, p, body)), memory)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"body": add(lambda xp, p, b: p.size + 1e-9)}, "at its null (size = 0) it changes"),
        ({"body": add(lambda xp, p, b: p.size / (p.size - 10.0))}, "at its upper bounds (size = 10) a step is not finite"),
        ({"body": add(lambda xp, p, b: 0.0 * p.size)}, "at its larger typical size it changes nothing"),
        ({"body": add(lambda xp, p, b: np.sin(p.size) * b.u)}, "compiled engines cannot trace it"),
        ({"body": add(lambda xp, p, b: p.siz)}, "has no attribute 'siz'"),
        ({"body": lambda xp, p, body: body}, "expected body(xp, p, body, memory, h)"),
        ({"name": "a b", "body": add(lambda xp, p, b: p.size)}, "name 'a b'"),
        (
            {
                "parameters": (Parameter(name="size", unit="N", low=0.0, high=1.0, typical=(0.5, 2.0)),),
                "body": add(lambda *a: 0.0),
            },
            "typical (0.5, 2.0) must lie within the bounds 0 to 1",
        ),
    ],
)
def test_an_effect_that_breaks_the_catalogues_rules_is_one_line(change, said):
    with pytest.raises(OwnCodeError, match=re.escape(said)) as caught:
        own_effects.check(Effect(**GIVEN | change), "effect mine")
    assert "\n" not in str(caught.value)


def test_own_effect_is_refused_if_its_name_exists_or_its_type_is_wrong(tmp_path, catalogue):
    head = "from fishmj.effects import Effect, Parameter\nfrom dataclasses import replace\nfrom fishmj import effects\n"
    path = write(tmp_path, head + "E = replace(effects.get('tether'))\nN = 3\n")
    with pytest.raises(ConfigError, match="'tether' is in the catalogue already"):
        own_effects.join([f"{path}:E"])
    with pytest.raises(OwnCodeError, match="is a int, expected a fishmj.effects.Effect"):
        own_effects.join([f"{path}:N"])


@pytest.mark.parametrize(
    ("main", "words"),
    [
        (plant, ["WEED=1", "--out", "OUT"]),
        (plant, ["WEED:drag=1", "--out", "OUT", "--generator", "lbm"]),
    ],
)
def test_second_robot_refuses_own_effects_without_running_their_code(main, words, tmp_path, capsys):
    path = write(tmp_path, "raise RuntimeError('this was run')\n")
    argv = [w.replace("WEED", f"{path}:WEED").replace("OUT", str(tmp_path / "out")) for w in words]
    said = refused(main, argv, capsys)
    assert "equations of its own" in said
    assert "fishmj evaluate --robot FISH.toml --effects" in said and "--generator log --from DATA" in said
    assert [p.name for p in tmp_path.iterdir()] == ["mine.py"]


def test_own_sensor_effect_is_applied_to_logs_and_other_kinds_are_refused(tmp_path, catalogue, capsys):
    head = "from fishmj.effects import Effect, Parameter\n"
    about = "stage='measurement', about='a', formula='f', source='s', shows=('position',)"
    size = "parameters=(Parameter(name='x', unit='m', low=-1.0, high=1.0, typical=(0.01, 0.05)),)"
    text = f"FAR = Effect(name='moved', {about}, {size}, measure=lambda xp, p, seen: seen._replace(x=seen.x + p.x))\n"
    path = write(tmp_path, head + text)
    write_dataset(tmp_path / "logs", {t.name: t for t in generate({}, ["idle", "gait"], 0)}, meta={"origin": "synthetic"})
    into = ["--generator", "log", "--from", str(tmp_path / "logs"), "--out"]
    assert console.run(plant, [f"{path}:FAR=0.25", *into, str(tmp_path / "far")]) == console.OK
    for name in ("01_idle", "02_gait"):
        before, now = (read_trial(tmp_path / folder / name).tables["pose"] for folder in ("logs", "far"))
        np.testing.assert_allclose(now["x"], before["x"] + 0.25, atol=1e-3)
        np.testing.assert_array_equal(now["y"], before["y"])
    assert json.loads((tmp_path / "far.truth.json").read_text())["effects"] == {"moved": {"x": 0.25}}
    said = refused(plant, [f"{EXAMPLE}:WEED=1", *into, str(tmp_path / "weed")], capsys)
    assert "'weed' acts before the sensors" in said and not (tmp_path / "weed").exists()
    assert "expected -1 to 1 m" in refused(plant, [f"{path}:FAR=7", *into, str(tmp_path / "weed")], capsys)


@pytest.mark.parametrize(
    ("verb", "needed"),
    [("evaluate.__main__", "pd"), ("train.__main__", "")]
    + [
        (f"gap.commands.{name}", needed)
        for name, needed in (("find", "D"), ("apply", "R"), ("check", "M --data D"), ("next_experiment", "R"))
    ],
)
def test_every_verb_with_effects_refuses_one_that_is_not_there(verb, needed, capsys):
    main = importlib.import_module(f"fishmj.{verb}").main
    assert "no module 'nowhere_9'" in refused(main, [*needed.split(), "--effects", "nowhere_9:X"], capsys)


# the page and Gymnasium


def test_the_page_quotes_the_examples_word_for_word():
    text = (ROOT / "examples" / "own_code.py").read_text(encoding="utf-8")
    page = (ROOT / "docs" / "simulate" / "your_own_code.md").read_text(encoding="utf-8")
    parts = re.split(rf"^# ({'|'.join(PARTS)})$", text, flags=re.MULTILINE)[1:]
    assert tuple(parts[::2]) == PARTS
    for name, part in zip(parts[::2], parts[1::2], strict=True):
        assert name == "algorithm" or f"```python\n{part.strip().replace('  # noqa: E402', '')}\n```" in page


def test_gymnasium_has_no_entry_points_and_import_registers_the_envs():
    """When this fails, Gymnasium has plugins again: register fishmj's ids by entry point, and mend the page."""
    import gymnasium

    folder = Path(gymnasium.__file__).parent
    assert not any("entry_points(" in path.read_text(encoding="utf-8") for path in folder.rglob("*.py"))
    code = "import fishmj, gymnasium; gymnasium.make('fishmj/StationHold-v0', engine='planar')"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False).returncode == 0
