"""The second robot beside the first: the same fish with the same servos, in water that somebody else described."""

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj import engines
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.log import excitation
from fishmj.mjcf import load_robot
from fishmj.water.flow import Flow, stack

RUNS = ("gait", "turn_left", "tow_ahead")


def first_robot(run):
    """(t, pose, joint) of the strip water, nominal, after every bus tick."""
    robot = load_robot()
    engine, rows = engines.make("batch", robot), -(-len(run.commands) // 10) * 10
    commands = np.concatenate([run.commands, np.repeat(run.commands[-1:], rows - len(run.commands), 0)])[None]
    state, params = engines.at_rest(robot, np.array([run.start])), engines.nominal_params(robot, 1)
    current, tick, parts = stack([Flow(turbulence="none", intensity=0.0)]), np.zeros(1, int), []
    state.v[0, :3] = run.push  # these runs start along the tank's x axis
    for k in range(0, rows, 10):
        state, trace = engine.advance(state, commands[:, k : k + 10], params, current, tick + k)
        parts.append((np.array(trace.pose)[0], np.array(trace.joint)[0]))
    pose, joint = (np.concatenate(part) for part in zip(*parts, strict=True))
    return (np.arange(rows) + 1) * 0.02, pose, joint


@pytest.fixture(scope="module", params=RUNS)
def both(request):
    """Name, end of the run; the first robot's trace; the second one's tables without noise and nuisance."""
    run = excitation.get(request.param)
    return request.param, first_robot(run), generate({}, [run], 0, noise=0.0, nuisance=0.0)[0].tables


def test_the_joints_do_the_same(both):
    _, (t, _, joint), tables = both
    for j in range(3):
        apart = np.interp(tables["joint"]["t"], t, joint[:, j]) - tables["joint"][f"j{j + 1}"]
        assert np.sqrt(np.mean(apart**2)) < np.radians(0.5)


def test_the_path_is_similar_and_far_outside_the_noise(both):
    name, (t, pose, _), tables = both
    seen = tables["pose"]
    late = seen["t"] - 0.065
    apart = np.stack([np.interp(late, t, pose[:, i]) - seen[c] for i, c in enumerate(("x", "y"))], 1)
    path = np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1).sum()
    worst = np.linalg.norm(apart, axis=1).max()
    assert 5 * 0.002 < worst < 0.25 * path, name


if __name__ == "__main__":  # the figures of docs/search/virtual_robot.md
    for name in (*excitation.DESIGNED, "gait_slow", "tow_ahead", "twirl", "spin"):
        if "north" in name:
            continue  # a fish that rests does so in both
        run = excitation.get(name)
        t, pose, joint = first_robot(run)
        tables = generate({}, [run], 0, noise=0.0, nuisance=0.0)[0].tables
        late = tables["pose"]["t"] - 0.065
        x, y, yaw = (np.interp(late, t, pose[:, i]) - tables["pose"][c] for i, c in enumerate(("x", "y", "yaw")))
        told = [np.interp(tables["joint"]["t"], t, joint[:, j]) - tables["joint"][f"j{j + 1}"] for j in range(3)]
        rms = [
            1e3 * np.sqrt(np.mean(x**2 + y**2)),
            np.degrees(np.sqrt(np.mean(yaw**2))),
            np.degrees(np.sqrt(np.mean(np.square(told), 1).max())),
        ]
        print(f"{name:16} path {rms[0]:5.0f} mm  heading {rms[1]:5.2f} deg  joint {rms[2]:5.2f} deg")
