"""A fish of five links, from eight answers to a policy that holds station: new, train, evaluate, replay.

    python examples/five_links.py [FOLDER]            4 M control steps, two minutes of one core; asserts that it holds
    python examples/five_links.py --smoke [FOLDER]    every part in short; the policy is not good and is not judged

Everything is synthetic: the water has the prior coefficients of the literature, fitted to no flow and to no fish.
"""

import sys
from pathlib import Path

from fishmj.base import console
from fishmj.base.store import read_json
from fishmj.evaluate.__main__ import main as evaluate
from fishmj.mjcf import geometry_of, load_robot
from fishmj.mjcf.new.__main__ import main as new
from fishmj.mjcf.new.swim_check import swim_of
from fishmj.sim import Sim
from fishmj.train.__main__ import main as train
from fishmj.view.replay.__main__ import main as replay

ANSWERS = "--length 0.6 --height 0.11 --width 0.07 --tail-height 0.14 --mass 1.6 --links 5 --servo lx-824".split()
STEPS = ("--steps", "4e6")  # 2e6 held with one seed of three
SHORT = ("--steps", "4e3", "--envs", "64"), ("--speeds", "0.2", "--los", "0,180", "--duration", "10")


def story(folder: Path, smoke: bool = False) -> dict:
    """All four commands in `folder`; what the judgement says: trial figures of the policy and of a fish that drifts."""
    fish, run, report = str(folder / "pike.toml"), str(folder / "run"), folder / "report"
    call(new, "pike", *ANSWERS, "--out", fish, "--force")
    call(train, "--preset", "quick", "--robot", fish, *(SHORT[0] if smoke else STEPS), "--out", run, "--force")
    policy = f"{run}/best.safetensors"
    judged = SHORT[1] if smoke else ()
    call(evaluate, policy, "drift", "--robot", fish, "--repeats", "1", *judged, "--out", str(report), "--log")
    trial = next(path.parent for path in sorted(report.rglob("meta.toml")) if "best" in str(path))
    pictures = ("--out", str(folder / "pike.html"), "--png", str(folder / "pike_swims.png"), "--at", "5")
    call(replay, str(trial), "--robot", fish, *pictures)
    return read_json(report / "results.json")


def call(command, *arguments: str) -> None:
    """Run a command as a user would, showing it."""
    room = command.__module__.removesuffix(".__main__")
    console.say("", f"$ python -m {room} {' '.join(arguments)}")
    code = command(list(arguments))
    assert not code, f"{room} ended with exit code {code}"


def physics(folder: Path) -> None:
    """What holds of the described fish whatever the policy does."""
    robot = load_robot(folder / "pike.toml")
    g, swim = geometry_of(robot), swim_of(Sim(robot))
    assert len(robot.links) == 5 and abs(sum(g.displaced) - robot.mass) < 1e-9, "it floats"
    assert abs(sum(g.displaced * (g.origin + g.buoyancy))) < 1e-3 * robot.mass * robot.length, "it lies level"
    assert 0.2 < swim.speed < robot.length and swim.torque < robot.servo.torque, "a wave swims ahead, within its servos"


def holds(found: dict) -> None:
    """What a policy that holds station does, in 24 currents that it cannot sense."""
    policy, drift = found["results"]
    at = {speed: {key: figure["value"] for key, figure in row.items()} for speed, row in policy["by_speed"].items()}
    arrived, near = policy["overall"]["arrival"]["value"], at["0.2"]["rmse_after_arrival"]
    console.say("", f"arrived in {arrived:.1%} of {policy['n']} trials; {near:.3f} m after arrival at 0.2 m/s")
    assert arrived >= 23 / 24, "it arrives"
    assert near < 0.10, "it holds within its arrival radius at 0.2 m/s"
    assert drift["overall"]["arrival"]["value"] < arrived, "a fish that drifts is carried away"
    assert at["0.1"]["power"] < at["0.2"]["power"] < at["0.3"]["power"], "a faster stream costs more to hold against"


def main(arguments: list[str]) -> None:
    smoke = "--smoke" in arguments
    folder = Path(next((a for a in arguments if a != "--smoke"), "runs/five_links"))
    found = story(folder, smoke)
    physics(folder)
    if not smoke:
        holds(found)
    console.say("", f"watch it: {folder / 'pike.html'}")


if __name__ == "__main__":
    main(sys.argv[1:])
