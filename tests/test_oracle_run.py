"""Runs of the immersed fish: state, trial folder, sub-steps, tanks, faults."""

import numpy as np
import pytest
import warp as wp

from fishmj.base.errors import ConfigError, OracleUnstable, SimDiverged, StoreError
from fishmj.lbm_oracle.cases.coupled_fish import beat, pond
from fishmj.lbm_oracle.cases.sphere import ball
from fishmj.lbm_oracle.fluid.domain_faces import PERIODIC
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.immersed import snapshot
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import sphere_markers
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.run import ConcurrentRuns, LeftDomain, Run
from fishmj.lbm_oracle.run.run_log import plausible_rows
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.time_refinement import _rescale, checkpoint
from fishmj.log import read_trial, write_trial
from fishmj.water.flow import Flow

wp.config.quiet = True


# runs and state -----------------------------------------------------------------------------------------------------


def test_a_restored_run_continues_to_the_bit(tmp_path):
    one = pond("cpu")
    beat(one, 0.1, every=1000)
    path = snapshot.save(tmp_path / "here.safetensors", one, why="test")
    beat(one, 0.1, every=1000)
    two = pond("cpu")
    assert snapshot.load(path, two)["why"] == "test"
    beat(two, 0.1, every=1000)
    for name, value in snapshot.snapshot(one).items():
        np.testing.assert_array_equal(snapshot.snapshot(two)[name], value, err_msg=name)


def test_a_state_of_another_grid_or_a_damaged_one_is_refused(tmp_path):
    path = snapshot.save(tmp_path / "here.safetensors", pond("cpu"))
    with pytest.raises(ConfigError, match="use its grid"):
        snapshot.load(path, pond("cpu", dt=0.002))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(StoreError):
        snapshot.load(path, pond("cpu"))


@pytest.mark.part("swim")
def test_a_run_writes_the_trial_folder_with_both_wrenches(tmp_path):
    run, gait = Run(pond("cpu"), latency=0.0), Gait()
    for _ in range(15):
        run.tick(gait(run.time))
    back = read_trial(write_trial(tmp_path / "swim", run.trial()))
    assert not [note for note in back.notes if "not in the schema" in note]
    wrench = back.table("wrench")
    assert {"f1x", "m4", "r1x", "n4"} <= set(wrench) and np.abs(wrench["f4y"]).max() > 0
    assert back.value("oracle.slip") == 1.0 and back.value("origin") == "synthetic"


def test_wrenches_add_up_to_what_moves_the_fish():
    """Sum of the link forces over a tick = change of the links' momentum; nothing else pushes."""
    coupled = pond("cpu")
    run, gait, gained = Run(coupled, latency=0.0), Gait(ramp=0.2), []
    for _ in range(20):
        before = coupled.body.solid_momentum()[:, :3].sum(0)
        run.tick(gait(run.time))
        gained.append(coupled.body.solid_momentum()[:, :3].sum(0) - before)
    force = np.array([row[-1][:, :3].sum(0) for row in run.rows])
    np.testing.assert_allclose(force[:, :2], np.array(gained)[:, :2] / 0.02, atol=0.05 * np.abs(force).max())


def test_a_wrench_that_was_taken_starts_anew_and_one_that_was_set_is_found():
    one, two = pond("cpu"), pond("cpu")
    for coupled in (one, two):
        beat(coupled, 0.1, every=1000)
    first, whole = one.take_wrench(1.0)[0], two.boundary.wrench.numpy().copy()
    np.testing.assert_array_equal(first, whole)
    assert np.abs(first).max() > 0 and not one.take_wrench(1.0)[0].any() and not one.boundary.wrench.numpy().any()
    for coupled in (one, two):
        coupled.step()
    second, whole = one.take_wrench(1.0)[0], two.take_wrench(1.0)[0]
    np.testing.assert_allclose(first + second, whole, rtol=1e-9, atol=1e-15)
    one.boundary.wrench.assign(first)
    np.testing.assert_array_equal(one.take_wrench(1.0)[0], first)


def test_a_run_that_leaves_its_box_keeps_what_it_recorded():
    def fence(coupled):
        if coupled.body.data.qpos[0] > 0.6001:
            raise LeftDomain("too far")

    run, gait = Run(pond("cpu"), latency=0.0, follow=fence), Gait(ramp=0.2)
    with pytest.raises(LeftDomain):
        for _ in range(200):
            run.tick(gait(run.time))
    assert 1 <= len(run.trial().table("pose")["t"]) < 200


def test_water_that_is_not_finite_stops_the_run():
    run = Run(pond("cpu"))
    values = run.coupled.fluid.f.numpy()
    values[0, 5, 5, 5] = np.nan
    run.coupled.fluid.f.assign(values)
    with pytest.raises((SimDiverged, OracleUnstable), match="not finite|is nan"):  # the fish or the watch, who meets it first
        for _ in range(20):
            run.tick(np.zeros(3))
    assert len(run.trial().table("pose")["t"]) < 20


def test_a_command_that_is_no_angle_is_refused():
    run = Run(pond("cpu"))
    for command in ([0.1, np.nan, 0.0], [0.1, 0.0], ["a", 0, 0], "abc", None):
        with pytest.raises(ConfigError, match=r"run: command.* expected finite numbers of shape \(3,\)"):
            run.tick(command)
    for option in ("prescribed", "follow"):
        with pytest.raises(ConfigError, match=f"run: {option} = 3; expected a function"):
            Run(run.coupled, **{option: 3})


def test_clocks_that_do_not_nest_are_refused():
    lattice = Lattice(dx=1.0, dt=1.0)
    with pytest.raises(ConfigError, match="same dt"):
        FluidStructure(Fluid(lattice, (16, 16, 16)), ball(4.0, Lattice(dx=1.0, dt=0.5)), sphere_markers(4.0, 1.0))
    with pytest.raises(ConfigError, match="nearest dt: 0.00285714"):
        Run(pond("cpu", dt=0.003))


def test_a_tick_too_fast_for_the_step_is_done_again_with_finer_ones(monkeypatch):
    """The trial is not lost, and it is the swim of a run that had the finer step throughout."""
    gait, ends = Gait(ramp=0.2), []
    for dt, limit in ((0.002, 10.0), (0.004, 0.3)):
        monkeypatch.setattr(Run, "limit", limit)
        run = Run(pond("cpu", dt=dt), prescribed=gait)
        for _ in range(15):
            run.tick()
        ends.append(run.pose)
        assert run.time == pytest.approx(0.3)
        assert (run.refined >= 5) == (limit < 1)
    np.testing.assert_allclose(ends[1][:3], ends[0][:3], atol=3e-3)
    np.testing.assert_allclose(ends[1][3:], ends[0][3:], atol=0.02)


@pytest.mark.parametrize("limit", ["speed", "lost"])
def test_water_that_a_fine_tick_left_too_fast_is_taken_on_with_finer_steps(monkeypatch, limit):
    """The look at the last step of a tick is judged in the next one, which cannot do the last one again; nor need it."""
    monkeypatch.setattr(Run, "limit", 0.3)
    run = Run(pond("cpu"), prescribed=Gait(ramp=0.2))
    while run.factor == 1 and run.ticks < 15:
        run.tick()
    assert run.factor == 2 and run.fastest > run.limit  # so will the next tick be
    found, refined = [OracleUnstable("seen at the end of that tick", limit=limit)], run.refined

    def end():
        if found:
            raise found.pop()

    monkeypatch.setattr(run.watch, "end", end)
    if limit == "speed":
        run.tick()
        assert run.factor == 4 and run.refined == refined + 1 and len(run.rows) == run.ticks
    else:
        with pytest.raises(OracleUnstable, match="seen at the end"):
            run.tick()


def test_a_tick_that_diverges_with_the_grids_steps_is_repeated(monkeypatch):
    """The attempt that is given up leaves no force behind, which the next one would take for a push from outside."""
    monkeypatch.setattr(Run, "limit", 0.3)
    run, wild = Run(pond("cpu"), prescribed=Gait(ramp=0.2)), [np.inf]
    while run.fastest < 0.2:
        run.tick()
    advance = run.coupled.body.advance
    monkeypatch.setattr(run.coupled.body, "advance", lambda v: advance(v * wild.pop() if wild else v))
    run.tick()
    assert run.factor == 2 and not wild and np.isfinite(run.pose).all()


@pytest.mark.parametrize("limit", ["speed", "density", "mass"])
@pytest.mark.parametrize("fast", [True, False])
def test_water_is_judged_before_the_next_tick_whatever_the_fish_does(monkeypatch, limit, fast):
    """The tick after water that was too fast or too dense has finer steps, even if the fish is slow."""
    monkeypatch.setattr(Run, "limit", 0.3 if fast else 10.0)
    run = Run(pond("cpu"), prescribed=Gait(ramp=0.2))
    while run.ticks < (9 if fast else 4):
        run.tick()
    found, factor = [OracleUnstable("seen at the end of that tick", limit=limit)], run.factor
    run.watch.pending = run.coupled.fluid, run.coupled.fluid.steps

    def end():
        if found:
            raise found.pop()

    monkeypatch.setattr(run.watch, "end", end)
    if limit == "mass":
        with pytest.raises(OracleUnstable, match="seen at the end"):
            run.tick()
    else:
        run.tick()
        assert run.factor == 2 * factor


def test_a_fish_that_leaves_in_a_finer_tick_stands_where_the_tick_began(monkeypatch):
    """Fish and water have one clock and one time step, so that the state can be kept and gone on with."""
    monkeypatch.setattr(Run, "limit", 0.2)
    run = Run(pond("cpu"), prescribed=Gait(ramp=0.2), follow=lambda coupled: None)
    while run.factor == 1:
        run.tick()
    before, steps = run.coupled.time, iter(range(3))

    def fence(coupled):
        if next(steps, None) is None:
            raise LeftDomain("left_domain: test")

    run.follow = fence
    with pytest.raises(LeftDomain):
        run.tick()
    coupled = run.coupled
    assert coupled.time == before == pytest.approx(coupled.fluid.time) and coupled.body.dt == coupled.fluid.lattice.dt


def test_finer_steps_have_the_present_flow(monkeypatch):
    monkeypatch.setattr(Run, "limit", 0.2)
    run = Run(pond("cpu"), prescribed=Gait(ramp=0.2))
    while run.factor == 1:
        run.tick()
    run.coupled.fluid.set_flow(Flow(speed=0.2))
    run.tick()
    fine = run._refinement.finer(2)
    assert run.factor > 1 and fine.fluid.flow == run.coupled.fluid.flow


def test_the_first_tick_of_joints_that_begin_at_speed_has_finer_steps():
    run = Run(pond("cpu"), prescribed=Gait(frequency=2.0, lag=0.0, ramp=0.0))
    run.tick()
    assert run.factor == 2


def test_a_refined_tick_logs_nothing_of_an_attempt_that_was_given_up(monkeypatch):
    """Too fast for two and four steps in one; then the same tick is taken with two and must log what a first attempt would."""
    logged = []
    for given_up in (False, True):
        monkeypatch.setattr(Run, "limit", 10.0)
        run = Run(pond("cpu"), prescribed=Gait(ramp=0.2))
        for _ in range(5):
            run.tick()
        kept = checkpoint(run.coupled)
        if given_up:
            monkeypatch.setattr(Run, "limit", 0.05)
            with pytest.raises(OracleUnstable, match="sub-steps take"):
                list(run._redo_tick(kept, 1))
            monkeypatch.setattr(Run, "limit", 10.0)
        attempt = run._redo_tick(kept, 1)
        with pytest.raises(StopIteration) as done:
            while True:
                next(attempt)
        logged.append(done.value.value[1:])
    np.testing.assert_allclose(logged[1], logged[0], rtol=1e-9, atol=1e-12)


def test_a_window_keeps_its_place_when_a_tick_is_done_again(monkeypatch):
    monkeypatch.setattr(Run, "limit", 0.2)
    small = Domain(name="small", shape=(60, 60, 20), dx=0.02, dt=0.004, follows=True, sponge=4)
    run = SwimSetup(domain=small, pose=(3.21, -1.07, 2.0)).run(prescribed=Gait(ramp=0.2))
    before = run.coupled.fluid.origin_lu.copy()
    for _ in range(12):
        run.tick()
    assert run.refined >= 3
    assert np.abs(run.coupled.fluid.origin_lu - before).max() <= 8
    np.testing.assert_array_equal(run.coupled.fluid.origin.numpy()[:3], run.coupled.fluid.origin_lu)
    assert np.hypot(*(run.pose[:2] - [3.21, -1.07])) < 0.1


def test_finer_steps_stay_until_the_fish_has_been_slow_for_long_enough(monkeypatch):
    """A change of the time step multiplies the energy of sound in the tank; one in every beat made it resonate."""
    monkeypatch.setattr(Run, "limit", 0.2)
    eased = lambda x: np.clip(x, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(x, 0.0, 1.0))
    bent = lambda t: np.full(3, 0.1 * eased(t / 0.12) + 0.1 * eased((t - 0.22) / 0.12))  # two bursts, with a rest of five ticks
    run, factors = Run(pond("cpu"), prescribed=bent), []
    run._refinement.stay = 8
    for _ in range(34):
        run.tick()
        factors.append(run.factor)
    first = factors.index(2)
    changes = [n for n, (a, b) in enumerate(zip(factors, factors[1:], strict=False), 1) if a != b]
    assert changes == [first, changes[-1]] and factors[-1] == 1, factors
    assert factors.count(2) == run.refined >= 8 + 3


def test_half_precision_populations_carry_the_same_start():
    ends = []
    for dtype in ("float32", "float16"):
        coupled = pond("cpu", dtype=dtype)
        beat(coupled, 0.3, every=1000)
        ends.append(coupled.body.data.qpos.copy())
    np.testing.assert_allclose(ends[1], ends[0], atol=5e-3)


def test_a_tick_that_no_sub_step_can_hold_stops_with_the_numbers():
    run = Run(pond("cpu"), prescribed=Gait(frequency=6.0, ramp=0.05))
    with pytest.raises(OracleUnstable, match="sub-steps take 3.46 m/s"):
        for _ in range(20):
            run.tick()


def test_tanks_side_by_side_swim_as_they_would_alone():
    gait = Gait(ramp=0.2)
    alone, *together = (Run(pond("cpu", slip=slip), latency=0.0) for slip in (1.0, 1.0, 0.0))
    tanks = ConcurrentRuns(together)
    for _ in range(5):
        command = gait(alone.time)
        alone.tick(command)
        assert tanks.tick([command, command]) == [0, 1]
    np.testing.assert_array_equal(together[0].pose, alone.pose)
    assert not np.array_equal(together[1].pose, alone.pose)


def test_a_tank_that_stops_leaves_the_others_swimming():
    def fence(coupled):
        raise LeftDomain("left_domain: test")

    tanks = ConcurrentRuns([Run(pond("cpu"), follow=fence), Run(pond("cpu"))])
    assert tanks.tick(np.zeros((2, 3))) == [1]
    assert tanks.tick(np.zeros((2, 3))) == [1]
    assert tanks.runs[0].stopped.startswith("left_domain") and tanks.runs[1].ticks == 2
    with pytest.raises(ConfigError, match="1 commands for 2 tanks"):
        tanks.tick(np.zeros((1, 3)))


@pytest.mark.gpu
def test_both_devices_swim_the_same_swim():
    ends = []
    for device in ("cpu", "cuda"):
        coupled = pond(device, slip=0.97)
        beat(coupled, 0.4, every=1000)
        ends.append(np.concatenate([coupled.body.data.qpos, coupled.body.data.qvel]))
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)


def test_implausibly_fast_rows_at_the_end_are_dropped_but_one_row_stays():
    row = lambda wz, rate=0.0: (0.0, 0.02, None, np.array([0, 0, 0, 0.1, 0, wz]), None, np.array([rate]))
    calm, wild = row(1.0), row(1e3)
    assert plausible_rows([calm, wild, calm]) == [calm, wild, calm]
    assert plausible_rows([calm, calm, row(1.0, -1e3), wild]) == [calm, calm]
    assert plausible_rows([wild]) == [wild]


def test_sound_gains_energy_where_the_time_step_changes_there_and_back():
    """2.5 (f^2 + b^2) - 3 f b cos(phase) with f = 3/4, b = 1/4 of the wave, forward and back, in the finer steps: 1 to 2.125."""
    cells = 128
    water = Fluid(Lattice(dx=0.02, dt=0.004, nu=4e-5), (cells, 2, 2), "cpu", boundaries=PERIODIC, subgrid="none")
    fine, wave = water.finer(2), 1e-3 * np.sin(2 * np.pi * np.arange(cells) / cells)
    ratios = []
    for phase in range(8):
        u = np.zeros((cells, 2, 2, 3))
        u[..., 0] = wave[:, None, None] * water.lattice.sound
        water.impose(u, np.broadcast_to(wave[:, None, None] * 1e3 * water.lattice.sound**2, u.shape[:3]))
        before = sound(water)
        rescaled(water, fine)
        fine.run(round(phase / 8 * cells * 3**0.5 / 2))
        rescaled(fine, water)
        ratios.append(sound(water) / before)
    assert np.mean(ratios) == pytest.approx(1.5625, rel=0.03)
    assert min(ratios) == pytest.approx(1.0, abs=0.03) and max(ratios) == pytest.approx(2.125, abs=0.05)


def sound(water: Fluid) -> float:
    """Energy of sound, m2/s2 over 2 and per cell: (P / (rho c))^2 + u^2."""
    return float(np.mean((water.pressure() / (1e3 * water.lattice.sound)) ** 2 + (water.velocity() ** 2).sum(-1)))


def rescaled(giver: Fluid, taker: Fluid) -> None:
    """Hands the water of one over to the other, which has another time step."""
    r = taker.lattice.dt / giver.lattice.dt
    inputs = [giver.f.flatten(), giver.u.flatten(), r, taker.f.flatten(), taker.u.flatten()]
    wp.launch(_rescale(giver.f.dtype, giver.u.dtype), dim=giver.cells, inputs=inputs, device=giver.device)
