"""Water on two levels: what crosses from the coarse to the finer box and back, what moves with a body, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.cases.refined import across, pulse_returned, shear_viscosity, water_and_box
from fishmj.lbm_oracle.cases.sphere import ball
from fishmj.lbm_oracle.fluid.domain_faces import channel
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.fluid.storage import UNIT
from fishmj.lbm_oracle.immersed.markers import sphere_markers
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid, _memory, fine_lattice, lowest
from fishmj.lbm_oracle.refined.refined_structure import RefinedStructure
from fishmj.lbm_oracle.run.domain import Domain, preset
from fishmj.lbm_oracle.run.run import Run
from fishmj.lbm_oracle.run.setup import DomainWatch, Gait, SwimSetup
from fishmj.lbm_oracle.run.time_refinement import checkpoint, hand_over, restore
from fishmj.water.flow import Flow

pytestmark = pytest.mark.oracle
STREAM = np.array([0.05, -0.03, 0.02])


def stirred(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A smooth velocity (..., 3) that is periodic over 16 x 14 x 12 cells, and no pressure."""
    a, b, c = (2 * np.pi * (x[..., i] + 0.5) / n for i, n in enumerate((16, 14, 12)))
    u = np.stack([np.sin(b) + np.cos(c + 1), np.sin(a + 2) - np.cos(c), np.cos(a) * np.sin(b)], -1)
    return 0.02 * u, np.zeros(x.shape[:-1])


def pair(subgrid="none", **options) -> RefinedFluid:
    return water_and_box((16, 14, 12), (4, 4, 3), (7, 6, 6), stirred, nu=1e-3, subgrid=subgrid, **options)


def test_the_fine_level_has_half_the_cell_and_step_and_the_same_viscosity():
    coarse = Lattice(dx=0.02, dt=0.004, corner=(-1.0, 0.0, 0.5))
    fine = fine_lattice(coarse)
    assert fine.velocity == coarse.velocity and fine.tau - 0.5 == pytest.approx(2 * (coarse.tau - 0.5))
    assert fine.to_si([2 * 7, 2 * 7, 2 * 7]) + fine.to_si([15, 15, 15]) == pytest.approx(2 * coarse.to_si([7, 7, 7]))


@pytest.mark.parametrize("subgrid", ["none", "wale"])
def test_a_uniform_stream_crosses_the_box_unchanged(subgrid):
    box = water_and_box(
        (16, 14, 12), (4, 4, 3), (7, 6, 6), lambda x: (np.zeros(x.shape) + STREAM, np.zeros(x.shape[:-1])), subgrid=subgrid
    )
    box.run(60)
    for level, where in ((box, box.box_slices()), (box.outer, ...)):
        assert level.velocity()[where] == pytest.approx(np.broadcast_to(STREAM, level.velocity()[where].shape), abs=1e-7)


@pytest.mark.parametrize("subgrid", ["none", "wale"])
def test_mass_and_momentum_of_both_levels_are_conserved(subgrid):
    box = pair(subgrid)
    before = box.totals()
    box.run(1000)  # 500 coarse steps
    assert box.totals() == pytest.approx(before, abs=2e-8 * box.outer.cells)  # 0.02 a cell moves
    assert np.abs(box.velocity()[box.box_slices()]).max() > 2e-3


def test_mass_and_momentum_are_kept_when_the_box_moves():
    box = pair()
    for by in ((1, 0, 0), (-1, 2, 1), (0, -3, -1)):
        box.run(6)
        box.complete()
        before, coarse = box.totals(), box.outer.f.numpy().copy()
        box.move(by)
        assert box.totals() == pytest.approx(before, abs=2e-8 * box.outer.cells)
        assert np.array_equal(box.outer.f.numpy(), coarse)  # what is left is there already


def test_a_shear_wave_decays_at_its_viscosity_on_both_levels():
    assert shear_viscosity() == pytest.approx((1.0, 1.0), abs=0.01)


def test_the_error_of_a_wave_across_both_levels_is_of_second_order():
    assert np.log2(across(n=16) / across(n=32)) == pytest.approx(2.0, abs=0.2)


def test_uniform_explosion_is_far_worse():
    """Why E is linear: the same wave with what the source of the scheme does."""
    linear, uniform = (across(linear=linear) for linear in (True, False))
    assert linear < 0.005 and uniform > 5 * linear


def test_a_sound_pulse_crosses_with_little_reflection():
    assert pulse_returned() < 0.003


def test_three_levels_conserve_too():
    middle = pair("wale")
    finest = RefinedFluid(middle, (12, 12, 10), (6, 5, 4))
    assert [level.lattice.dx for level in finest.levels] == [0.25, 0.5, 1.0]
    before = finest.totals()
    finest.run(200)
    finest.complete()
    assert (finest.steps, middle.steps, middle.outer.steps) == (200, 100, 50)
    assert finest.totals() == pytest.approx(before, abs=2e-8 * middle.outer.cells)
    fine = finest.velocity()[finest.box_slices()].reshape(6, 2, 5, 2, 4, 2, 3).mean((1, 3, 5))
    x, y, z = (slice(a - b, a - b + n) for a, b, n in zip((12, 12, 10), middle.origin_lu, (6, 5, 4), strict=True))
    assert middle.velocity()[x, y, z] == pytest.approx(fine, abs=UNIT * middle.lattice.velocity)


def test_a_box_shows_at_its_rim_all_that_the_water_outside_sees():
    """Only the rim is restricted: outside every number is the same as when all cells are."""
    finest, full = (RefinedFluid(pair("wale"), (12, 12, 10), (6, 5, 4)) for _ in range(2))
    for box in full.boxes:
        box._rim = box._all
    assert all(len(box._rim) < len(box._all) for box in finest.boxes)
    for steps, by in ((2, None), (1, None), (3, None), (0, (1, -1, 1)), (1, None), (5, None), (4, None)):
        for water in (finest, full):
            water.run(steps)
            if by:
                assert water.whole and not water.outer.whole
                water.move(by)
        for one, other in zip(finest.levels, full.levels, strict=True):
            same = (one.f.numpy() == other.f.numpy()).all(0) & (one.u.numpy() == other.u.numpy()).all(-1)
            counts = np.ones(one.shape, bool)
            if isinstance(one, RefinedFluid):  # ghosts are read by nobody, but for what enters
                counts[:] = False
                counts[_memory(one, one.first_lu, 2 * one.size_lu)] = True
            for box in (box for box in finest.boxes if box.outer is one):
                counts[_memory(one, box.low_lu + 1, box.size_lu - 2)] = False
            assert same[counts].all()
    for water in (finest, full):
        water.complete()
    for one, other in zip(finest.levels[1:], full.levels[1:], strict=True):
        box = next(box for box in finest.boxes if box.outer is one)
        under = _memory(one, box.low_lu, box.size_lu)
        assert (one.f.numpy()[:, *under] == other.f.numpy()[:, *under]).all()


def test_a_period_of_steps_returns_to_the_same_copies():
    """What a captured graph relies on, and its account on the host."""
    box = pair()
    box.stream_collide()
    at, account = box.phase, box.account
    phases = []
    for _ in range(box.period):
        phases.append(box.phase)
        box.stream_collide()
    assert box.phase == at and len(set(phases)) == box.period == 4
    done = box.account
    box.account = account
    box.skip(box.period)
    assert box.account == done


def test_the_levels_agree_where_both_are():
    """Asked for, the cells under the box hold the means of their children."""
    box = pair()
    box.run(10)
    box.complete()
    x, y, z = box.box_slices()
    fine = box.velocity()[x, y, z].reshape(7, 2, 6, 2, 6, 2, 3).mean((1, 3, 5))
    assert box.outer.velocity()[4:11, 4:10, 3:9] == pytest.approx(fine, abs=1e-6)


def test_restored_levels_go_on_bit_for_bit():
    box, other = pair("wale"), pair("wale")
    box.run(6)
    box.move((1, 0, -1))
    state = box.snapshot()
    box.run(8), other.restore(state), other.run(8)
    inside = (slice(None), *_memory(box, box.first_lu, 2 * box.size_lu))
    assert np.array_equal(box.f.numpy()[inside], other.f.numpy()[inside])
    assert np.array_equal(box.outer.f.numpy(), other.outer.f.numpy())
    assert (other.steps, other.outer.steps, other.low_lu.tolist()) == (14, 7, [5, 4, 2])


def test_a_clock_is_that_of_both_levels():
    box = pair()
    box.set_steps(-4)
    assert (box.steps, box.outer.steps) == (-4, -2)
    assert (int(box.clock.numpy()[0]), int(box.outer.clock.numpy()[0])) == (-4, -2)
    with pytest.raises(ConfigError, match="3 steps"):
        box.set_steps(3)


def test_a_state_does_not_depend_on_how_a_box_numbers_its_nodes():
    """Along z: by default so that it begins at a multiple of 8."""
    aligned, plain = (RefinedFluid(pair("wale").outer, (4, 4, 3), (7, 6, 6), numbers=numbers) for numbers in (None, 0))
    assert (aligned.first_lu[2], plain.first_lu[2]) == (8, 6) and aligned.shape[2] % 8 == 0
    for box in (aligned, plain):
        box.run(4)
        box.move((1, 0, 1))
        box.run(4)
    state, other = aligned.snapshot(), plain.snapshot()
    assert state.keys() == other.keys() and state["f"].shape == (19, *aligned.extent)
    assert state["origin"].tolist() == other["origin"].tolist()
    low, size = plain.first_lu, 2 * plain.size_lu
    inside = np.ix_(*((a + np.arange(n)) % m for a, n, m in zip(low, size, plain.extent, strict=True)))
    assert np.array_equal(state["f"][:, *inside], other["f"][:, *inside])
    assert np.array_equal(aligned.velocity()[aligned.box_slices()], plain.velocity()[plain.box_slices()])
    plain.restore(state)
    aligned.run(4), plain.run(4)
    assert np.array_equal(aligned.velocity()[aligned.box_slices()], plain.velocity()[plain.box_slices()])


def test_turbulence_passes_through_the_box():
    flow = Flow(speed=0.3, direction=0.4, turbulence="default", intensity=0.1, seed=3)
    make = lambda: Fluid(Lattice(dx=0.02, dt=0.004), (32, 24, 14), boundaries=channel(sponge=4), flow=flow)
    plain, box = make(), RefinedFluid(make(), (11, 8, 4), (10, 8, 6))
    plain.run(120), box.run(240)
    where = slice(11, 21), slice(8, 16), slice(4, 10)
    without, with_it = plain.velocity()[where], box.outer.velocity()[where]
    assert np.sqrt(((with_it - without) ** 2).mean()) < 0.15 * without.std((0, 1, 2)).mean()
    assert with_it.std() == pytest.approx(without.std(), rel=0.05)


def ball_in_a_box(radius: float = 4.0):
    """Sphere of so many fine cells in periodic water, coarse cells of 2 m, steps of 2 s; and the function that moves its box."""
    outer = Fluid(Lattice(dx=2.0, dt=2.0, rho=1.0, nu=0.02), (24, 20, 18), subgrid="none")
    at = np.array([20.3, 19.1, 17.2])
    box = RefinedFluid(outer, lowest(outer, at, (9, 9, 9)), (9, 9, 9))
    body = ball(radius, box.lattice, at=at)
    coupled = RefinedStructure(box, body, sphere_markers(radius, 1.0), slip=0.0)
    return coupled, lambda: box.centre_on(body.data.qpos)


def test_the_water_gains_what_a_body_in_the_box_gives():
    """A sphere that is pushed through the box, which follows it: the momentum of both levels is the impulse of the markers."""
    coupled, follow = ball_in_a_box()
    water = coupled.fluid
    before, given, moved = water.totals(), 0.0, 0
    for n in range(120):
        coupled.step(np.ones(3), [0.05, 0.01, 0.0])
        given = given - coupled.take_wrench(1.0)[0][0, :3]
        moved += n % 2 == 1 and follow()
    assert moved >= 2 and water.totals()[0] == pytest.approx(before[0], abs=1e-3)
    assert water.totals()[1:] - before[1:] == pytest.approx(given, abs=1e-4 * np.abs(given).max())


def test_a_body_that_leaves_its_box_is_refused():
    coupled, _ = ball_in_a_box()
    q = coupled.body.data.qpos.copy()
    q[1] += 5.0
    coupled.body.place(q)
    with pytest.raises(ConfigError, match="end of the finer box on axis y"):
        coupled.step(np.ones(3), np.zeros(3))


def test_a_box_that_does_not_fit_is_refused():
    water = Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0), (16, 14, 12), boundaries=channel(sponge=2))
    with pytest.raises(ConfigError, match="axis y.*with 2 to spare"):
        RefinedFluid(water, (4, 9, 4), (6, 4, 4))
    with pytest.raises(ConfigError, match="fills axis z, which must be periodic"):
        RefinedFluid(water, (4, 4, 0), (6, 4, 12))
    with pytest.raises(ConfigError, match="float16"):
        RefinedFluid(Fluid(water.lattice, (16, 14, 12), dtype="float16"), (4, 4, 4), (6, 4, 4))


def test_what_a_refined_box_cannot_do_is_refused():
    box = pair()
    with pytest.raises(ConfigError, match="to spare"):
        box.move((9, 0, 0))
    assert box.low_lu.tolist() == [4, 4, 3]
    box.stream_collide()
    with pytest.raises(ConfigError, match="between two coarse steps"):
        box.move((1, 0, 0))
    with pytest.raises(ConfigError, match="between two coarse steps"):
        box.snapshot()
    with pytest.raises(ConfigError, match="outer.shift"):
        box.shift((1, 0, 0))


def test_the_box_follows_the_fish_and_stays_in_the_tank():
    domain = preset("laptop_refined")
    assert domain.body_level.dx == domain.dx / 2 and domain.body_level.dt == domain.dt / 2
    coupled = SwimSetup(domain=domain, pose=(0.31, 0.0, 0.0)).coupled()
    body, box, edge = coupled.body, coupled.fluid, DomainWatch(domain)
    off = lambda: np.abs(box._offset_of(0.5 * np.sum(body.bounds(coupled.boundary.corners), 0)))
    assert off().max() <= 1.0
    assert coupled.boundary.lattice.dx == 0.01
    q = body.data.qpos.copy()
    q[0] += 0.05
    body.place(q)
    assert edge.follow(coupled) and off().max() <= 1.0
    assert not edge.follow(coupled)


POOL = Domain(name="pool", shape=(36, 24, 16), dx=0.04, dt=0.01, sponge=4, fine=(0.72, 0.44, 0.32))
QUICK = Gait(frequency=2.0, ramp=0.1)


def pool(domain: Domain = POOL, **options) -> Run:
    return SwimSetup(domain=domain, flow=Flow(speed=0.1, direction=3.0), slip=0.98, spacing=0.5).run(latency=0.0, **options)


def test_a_tick_that_is_too_fast_is_done_again_on_both_levels():
    """As if every tick had ended too fast: the swim is that of half the time step from the start."""
    half, again = pool(replace(POOL, dt=0.005)), pool()
    for _ in range(5):
        again.fastest = 10.0
        again.tick(QUICK(again.time)), half.tick(QUICK(half.time))
    water = again.coupled.fluid
    assert again.refined == 5 and (water.steps, water.outer.steps) == (20, 10)
    assert int(water.clock.numpy()[0]) == 20 and int(water.outer.clock.numpy()[0]) == 10
    assert again.angles() == pytest.approx(half.angles(), abs=2e-4) and again.pose[:3] == pytest.approx(half.pose[:3], abs=1e-5)
    off = [
        np.abs(a.velocity() - b.velocity()).max()
        for a, b in ((water, half.coupled.fluid), (water.outer, half.coupled.fluid.outer))
    ]
    assert max(off) < 2e-3


def test_levels_survive_another_time_step_and_back():
    run = pool()
    for _ in range(3):
        run.tick(QUICK(run.time))
    water = run.coupled.fluid
    before = [level.velocity() for level in water.levels], water.account
    fine = run._refinement.finer(2)
    hand_over(run.coupled, fine)
    assert fine.fluid.account[1][1] == 2 * before[1][1][1] and fine.fluid.outer.lattice.dt == 0.005
    hand_over(fine, run.coupled)
    for level, velocity in zip(water.levels, before[0], strict=True):
        assert level.velocity() == pytest.approx(velocity, abs=2 * UNIT * level.lattice.velocity)  # kept anew twice
    assert water.account == before[1]


@pytest.mark.parametrize("case", ["finer water made before", "checkpoint from before"])
def test_a_repeated_tick_knows_where_its_box_has_moved(case):
    """Twins of one swim; in one the box moves after the finer water, or the checkpoint, was made. Both then do the same ticks."""
    one, twin, again = pool(), pool(), case == "finer water made before"
    for run in (one, twin):
        run.tick(QUICK(run.time))
    if again:
        one._refinement.finer(2)
        for run in (one, twin):
            run.coupled.fluid.move((1, 0, 0))
    else:
        kept = checkpoint(one.coupled)
        one.coupled.fluid.move((1, 0, 0))
        restore(one.coupled, kept)
    for _ in range(2):
        for run in (one, twin):
            run.fastest = 10.0 if again else 0.0
            run.tick(QUICK(run.time))
    assert one.refined == 2 * again and (one.angles() == twin.angles()).all() and (one.pose == twin.pose).all()
    for mine, its in zip(one.coupled.fluid.levels, twin.coupled.fluid.levels, strict=True):
        assert (mine.origin_lu == its.origin_lu).all() and (mine.velocity() == its.velocity()).all()


def test_a_tick_of_half_a_coarse_step_is_refused():
    with pytest.raises(ConfigError, match="no multiple of the coarse dt = 0.008"):
        pool(replace(POOL, dt=0.008))


def test_a_run_on_the_device_redoes_ticks_and_moves_boxes_as_the_host_does(monkeypatch):
    """What a GPU does by default: a tick of all levels at once, and finer steps by the host where it was too fast."""
    monkeypatch.setattr(Run, "limit", 0.45)
    ends = []
    for on_device in (False, True):
        run = pool(replace(POOL, fine=(0.96, 0.52, 0.32)), on_device=on_device)
        body, low = run.coupled.body, run.coupled.fluid.low_lu.copy()
        body.place(body.data.qpos.copy(), [0.4] + [0.0] * (body.dofs - 1))
        for _ in range(11):
            run.tick(QUICK(run.time))
        water = run.coupled.fluid
        ends.append((run.refined, (water.low_lu - low).tolist(), water.steps, run.pose, run.angles()))
    one, other = ends
    assert other[:3] == one[:3] and one[0] > 0 and any(one[1])
    np.testing.assert_allclose(np.concatenate(other[3:]), np.concatenate(one[3:]), atol=1e-9)
