"""Effects of a robot that act by chance or by a hidden phase: their draws, and what those add to the likelihood. *Synthetic*."""

from types import SimpleNamespace

import numpy as np
import pytest
from robot_arm import ARM
from robot_laws import write_law_logs
from test_gap_robot import records_of

from fishmj import effects
from fishmj.effects.effect import Parameter
from fishmj.gap.decide.decide import near_in_likelihood
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.null.robot_null import RobotNull
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.search.drawn_effects import drawn_candidates, in_own_scatter
from fishmj.gap.search.fit import EffectFitter
from fishmj.gap.search.likelihood import Likelihood, costs, losses

DRAWN = {"latency_jitter": ("sigma", 0.02), "packet_loss": ("probability", 0.5), "command_hold": ("period", 0.05)}


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """(model, likelihood with torques as stated) of an arm whose commands come late by chance."""
    folder = tmp_path_factory.mktemp("late")
    path = folder / "arm.xml"
    path.write_text(ARM)
    robot = read_robot(path)
    records = records_of(robot, write_law_logs(folder / "logs", 2, 2.6, packets=0.008, late=0.02))
    model = RigidRobot(robot, sizes_of(robot, records), [effects.robot_catalogue()[n] for n in (*DRAWN, "command_latency")])
    null = RobotNull(12).residuals(model, records, ResidualLayout(records))
    return model, Likelihood(model, records, null)


@pytest.mark.parametrize("name", DRAWN)
def test_command_is_the_mean_of_the_draws(name):
    form, t = effects.robot_catalogue()[name].robot, 0.01 * np.arange(60)
    p, c = SimpleNamespace(**dict([DRAWN[name]])), np.sin(9.0 * t)
    grid = np.arange(0.1, 0.55, 0.001)
    held = lambda told: told[1][np.searchsorted(told[0], grid, side="right") - 1]
    drawn = np.array([held(form.scatter(np.random.default_rng(k), p, t, c)) for k in range(400)])
    off = np.abs(drawn.mean(0) - held(form.command(p, t, c)))
    assert off.max() < 0.06 and np.sqrt(np.mean(off**2)) < 0.02  # of a sine of amplitude 1
    assert drawn.std(0).mean() > 0.05


def test_stairs_of_a_simulation_begin_at_the_first_command():
    form = effects.robot_catalogue()["command_hold"].robot
    t, c = form.simulated(SimpleNamespace(period=0.03), 0.01 * np.arange(7), np.arange(7.0))
    taken = c[np.searchsorted(t, [0.001, 0.029, 0.031, 0.061], side="right") - 1]
    np.testing.assert_array_equal(taken, [0.0, 0.0, 3.0, 6.0])


def test_scatter_moves_its_own_segment_only(late):
    model, e = late
    row = model.null
    assert model.scatter(e.records, e.layout, row) == ()
    row[model.index("command_latency", "delay")] = 0.01
    assert model.scatter(e.records, e.layout, row) == ()
    row[model.index("latency_jitter", "sigma")] = 0.02
    first, _ = model.scatter(e.records, e.layout, row)
    t = np.concatenate([b.t for b in e.layout.blocks if b.record == 0])
    place = np.searchsorted(e.records[0].starts, t, side="right") - 1
    assert all(len(np.unique(place[values != 0.0])) == 1 for values in first)
    row[model.index("latency_jitter", "sigma")] = 0.01
    less, _ = model.scatter(e.records, e.layout, row)
    assert np.sum(less**2) < 0.6 * np.sum(first**2)


def test_scatter_tells_jitter_from_a_latency(late):
    """A latency leaves what no model's mean can say; a jitter of the same mean says how large it is, and when."""
    model, e = late
    base, keep = e.subset().base(), np.ones(len(e.records), bool)
    found = {}
    for effect in model.active.effects:
        if effect.name in DRAWN:
            best = min(drawn_candidates(e, keep, base, effect), key=lambda c: c.cost)
            found[effect.name] = in_own_scatter(e, best)
        else:
            rows = np.tile(model.null, (20, 1))
            rows[:, model.index(effect.name, "delay")] = np.linspace(0.01, 0.1, 20)
            whole = e.subset()
            found[effect.name] = min((whole.at(row) for row in rows), key=lambda c: c.cost)
    loss = {name: e.linearised_at(c.row).loss(c.row) for name, c in found.items()}
    assert min(loss, key=loss.get) == "latency_jitter"
    assert loss["latency_jitter"] < loss["command_latency"] - 100.0
    sigma = found["latency_jitter"].row[model.index("latency_jitter", "sigma")]
    assert sigma == pytest.approx(0.02, rel=0.25)


def test_of_two_effects_that_draw_one_must_lead_by_more(late):
    model, e = late
    lead = {"latency_jitter": 0.0, "packet_loss": 60.0, "command_hold": 160.0, "command_latency": 60.0}
    ranked = tuple(SimpleNamespace(names=(name,), newest=(name,), cost=cost) for name, cost in lead.items())
    step = SimpleNamespace(accepted=True, ranked=ranked)
    assert near_in_likelihood(SimpleNamespace(near=e, steps=(step,)), "latency_jitter") == {"packet_loss"}


def test_losses_of_the_records_are_the_loss_of_all(late):
    model, e = late
    row = model.null
    row[model.index("packet_loss", "probability")] = 0.4
    fitter = e.with_scatter(row).subset()
    z = fitter.z(row[None])[0]
    np.testing.assert_allclose(losses(fitter, z).sum(), costs(z, e.layout).sum() + fitter.whiten.logdet)


def test_grid_reaches_steps_as_large_as_the_bound():
    p = Parameter(name="step", unit="rad", low=0.0, high=2.0, typical=(0.05, 0.3), fine=True)
    effect, c = SimpleNamespace(name="stairs", parameters=(p,)), np.sin(0.37 * np.arange(400.0))
    stairs = lambda step: step * np.floor(c / step + 0.5) if step else c
    model = SimpleNamespace(
        index=lambda name, parameter: 0,
        predict=lambda records, rows: [{"joint": np.array([stairs(row[0]) for row in np.atleast_2d(rows)])}],
        null=np.zeros(1),
        constants=(),
        active=SimpleNamespace(effects=(effect,)),
    )
    layout = SimpleNamespace(residuals=lambda told: stairs(1.1) - told[0]["joint"])
    fitter = EffectFitter(model, [], layout, lambda residual: residual)
    (best, *_) = fitter.grid_search(fitter.base(), [effect])["stairs"]
    assert best == pytest.approx(1.1, rel=0.02)
