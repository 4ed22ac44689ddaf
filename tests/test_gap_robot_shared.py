"""One kind of effect at many joints of a robot as one candidate of a round. Logs are *synthetic*."""

import mujoco
import numpy as np
import pytest
from test_gap_robot import records_of

from fishmj import effects
from fishmj.gap.commands.find_robot import by_effect, robot_gates, without_stand_in
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.null.robot_null import RobotNull
from fishmj.gap.search.fit import on_records
from fishmj.gap.search.likelihood import likelihood_of
from fishmj.gap.search.shared_effects import apart, kinds, shared_candidates, shares
from fishmj.gap.search.stepwise import CrossValidatedFit, SelectionStep, best_kind, forward_select, split
from fishmj.gap.verdict import NamedEffect, Value, Verdict

pytest.importorskip("numba")
SOME = ("coulomb_friction", "viscous_friction", "torque_offset", "rotor_inertia", "command_latency")
HIDDEN = (0.03, 0.06, 0.045, 0.0, 0.08)  # N m of dry friction


def legs(count: int, friction=None) -> str:
    """`count` hinged legs on a fixed base, each with a servo."""
    rub = friction or [0.0] * count
    one = (
        '<body name="leg{0}" pos="{0} 0 0"><joint name="hip{0}" axis="0 1 0" damping="0.02" frictionloss="{1}"/>'
        '<inertial pos="0 0 -0.15" mass="0.4" diaginertia="0.003 0.003 0.0003"/></body>'
    )
    servo = '<position name="hip{0}" joint="hip{0}" kp="4" kv="0.1"/>'
    bodies = "".join(one.format(i, f) for i, f in enumerate(rub))
    return (
        '<mujoco model="legs"><option timestep="0.002" integrator="implicitfast"/>'
        f"<worldbody>{bodies}</worldbody><actuator>{''.join(servo.format(i) for i in range(count))}</actuator></mujoco>"
    )


def write_legs(folder, friction, logs: int = 3, seconds: float = 2.6) -> None:
    """Logs of the legs with dry friction, as CSV, 250 Hz."""
    folder.mkdir()
    count = len(friction)
    for k in range(logs):
        m = mujoco.MjModel.from_xml_string(legs(count, friction))
        d, rng = mujoco.MjData(m), np.random.default_rng(k)
        m.opt.timestep = 0.0002
        t = 0.002 * np.arange(round(seconds / 0.002))
        rates, phases = rng.uniform(0.3, 2.2, (2, count, 3)), rng.uniform(0, 6.28, (2, count, 3))[0]
        asked = 0.25 * np.sum(np.sin(2 * np.pi * rates[0][..., None] * t + phases[..., None]), 1).T
        q = np.empty_like(asked)
        for i in range(len(t)):
            q[i], d.ctrl[:] = d.qpos, asked[i]
            mujoco.mj_step(m, d, 10)
        q += 2e-4 * rng.standard_normal(q.shape)
        names = [f"{what}_hip{j}" for what in ("cmd", "pos") for j in range(count)]
        rows = (",".join(f"{x:.6f}" for x in (t[i], *asked[i], *q[i])) for i in range(0, len(t), 2))
        (folder / f"log{k}.csv").write_text("\n".join([",".join(["t", *names]), *rows]) + "\n")


@pytest.mark.slow
def test_friction_of_many_joints_comes_in_one_round_with_a_value_for_each(tmp_path):
    (tmp_path / "legs.xml").write_text(legs(len(HIDDEN)))
    write_legs(tmp_path / "logs", HIDDEN)
    robot = read_robot(tmp_path / "legs.xml")
    records, null = records_of(robot, tmp_path / "logs"), RobotNull(16)
    model = RigidRobot(robot, sizes_of(robot, records), [effects.robot_catalogue()[name] for name in SOME])
    said: list[str] = []
    found = forward_select(likelihood_of(model, records, null), robot_gates(), split(records), said.append)
    first = found.steps[0].ranked[0]
    assert first.added == 4 and said[0].startswith("Coulomb friction at 4 joints: gain")
    rubs = {name for name in found.best.names if name.startswith("coulomb_friction")}
    assert rubs == {f"coulomb_friction@hip{j}" for j, size in enumerate(HIDDEN) if size}
    for j, size in enumerate(HIDDEN):
        place = model.index(f"coulomb_friction@hip{j}", "torque")
        assert found.best.row[place] == pytest.approx(size, abs=0.1 * max(HIDDEN))
    assert apart(model, "coulomb_friction@hip0", "rotor_inertia@hip1")
    assert not apart(model, "coulomb_friction@hip0", "command_latency")


def test_single_effects_beside_a_kind_are_fitted_to_all_records(tmp_path):
    (tmp_path / "legs.xml").write_text(legs(4))
    write_legs(tmp_path / "logs", [0.06] * 4, logs=2)
    robot = read_robot(tmp_path / "legs.xml")
    records = records_of(robot, tmp_path / "logs")
    model = RigidRobot(robot, sizes_of(robot, records), [effects.robot_catalogue()[name] for name in SOME[:1]])
    e = likelihood_of(model, records, RobotNull(16))
    whole, few = e.subset(), e.subset(np.arange(len(e.layout.records)) == 0)
    base = on_records(few, whole.base())
    screened = few.screen(base, model.active.effects)
    many, alone = shared_candidates(whole, whole.base(), base, screened, robot_gates())
    assert [c.added for c in many] == [4] and len(alone) == 4
    for c in (*many, *alone):
        assert c.z.size == e.layout.size and np.isfinite(whole.evidence(c))


def test_a_second_search_begins_with_the_best_kind_where_an_effect_of_the_whole_robot_came_first(tmp_path):
    (tmp_path / "legs.xml").write_text(legs(4))
    write_legs(tmp_path / "logs", [0.06] * 4, logs=4)
    robot = read_robot(tmp_path / "legs.xml")
    records, gates = records_of(robot, tmp_path / "logs"), robot_gates()
    chosen = [effects.robot_catalogue()[name] for name in ("coulomb_friction", "command_latency")]
    model = RigidRobot(robot, sizes_of(robot, records), chosen)
    e, folds = likelihood_of(model, records, RobotNull(16)), split(records)
    whole = e.subset()
    screened = whole.screen(whole.base(), model.active.effects)
    kind, *_ = shared_candidates(whole, whole.base(), whole.base(), screened, gates)[0]
    (late,) = [c for c in screened if c.newest == ("command_latency",)]
    (rubs,) = [c for c in screened if c.newest == ("coulomb_friction@hip0",)]
    nothing = CrossValidatedFit(e, whole.base(), (whole.base(),) * len(folds))
    first = lambda *ranked, accepted=True: SelectionStep(ranked, nothing, 1e4, accepted)
    again = best_kind(nothing, first(late, rubs, kind), gates, folds)
    assert again.accepted and again.gain > again.asked == 4 * gates.gain
    assert set(again.fitted.best.names) == set(kind.names) == {f"coulomb_friction@hip{j}" for j in range(4)}
    assert [c.newest for c in again.ranked] == [kind.newest, late.newest, rubs.newest]
    for other in (first(late, rubs), first(rubs, late, kind), first(kind, late), first(late, kind, accepted=False)):
        assert best_kind(nothing, other, gates, folds) is None


def test_robot_of_three_joints_is_searched_joint_by_joint(tmp_path):
    (tmp_path / "legs.xml").write_text(legs(3))
    robot = read_robot(tmp_path / "legs.xml")
    write_legs(tmp_path / "logs", HIDDEN[:3], logs=1)
    model = RigidRobot(robot, sizes_of(robot, records_of(robot, tmp_path / "logs")), [])
    assert not shares(model) and not apart(model, "coulomb_friction@hip0", "coulomb_friction@hip1")
    three = tuple(f"coulomb_friction@hip{j}" for j in range(3))
    assert kinds(three) == list(three)
    assert kinds((*three, "rotor_inertia@hip0", "coulomb_friction@hip3")) == ["coulomb_friction@4 joints", "rotor_inertia@hip0"]


def test_value_that_is_not_believable_costs_the_names_of_its_own_joint_only():
    value = {"torque": Value(0.05, "N m", 0.04, 0.06)}
    effect = lambda name: NamedEffect(name, value, 1.0, 0.9)
    names = [f"{kind}@hip{j}" for kind in ("coulomb_friction", "rotor_inertia") for j in range(4)] + ["command_latency"]
    doubt = ("Coulomb friction at hip1: the records disagree about its size by more than 30 %",)
    found = without_stand_in(Verdict("CLASS", effects=tuple(map(effect, names)), warnings=doubt))
    told = by_effect(found)
    assert found.answer == "NAMED" and set(told.values()) == {"NAMED"}
    assert {e.name for e in found.tentative} == {"coulomb_friction@hip1", "rotor_inertia@hip1"} == set(names) - set(told)
    few = Verdict("CLASS", effects=tuple(map(effect, names[:2])), warnings=doubt)
    assert without_stand_in(few).answer == "UNEXPLAINED" and set(by_effect(few).values()) == {"CLASS"}
