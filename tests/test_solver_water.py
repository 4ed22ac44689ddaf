"""Which water of the solver is meant: the plain one, the reference, or what options say; and the plans solved in it."""

from argparse import Namespace
from dataclasses import replace

import pytest

from fishmj import control
from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName, UsageError
from fishmj.engines.hybrid import HybridOptions
from fishmj.engines.lbm import LbmEngine
from fishmj.evaluate import __main__ as evaluate
from fishmj.evaluate import run_trials, trials
from fishmj.gap.calibrate import slip
from fishmj.gap.calibrate.__main__ import reference_grid
from fishmj.hydro_fit.campaign.dagger import dagger
from fishmj.hydro_fit.campaign.data import collect
from fishmj.hydro_fit.campaign.data import plan as plans
from fishmj.hydro_fit.campaign.data.run_segments import Setup
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.markers import FINS, Sharpness
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, preset
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, PLAIN, REFERENCE, REFERENCES, asked_for, boundary_name, water_of_fit
from fishmj.mjcf import load_robot
from fishmj.train import correct_water
from fishmj.train.settings import change
from fishmj.train.settings import preset as train_preset
from fishmj.water.choice import in_water
from fishmj.water.flow import Flow
from fishmj.water.hydro_model import HydroModel
from studies.rank_waters import rank_waters_command


def test_plain_is_the_papers_tank_and_options_change_it():
    assert (PLAIN.domain, PLAIN.slip) == ("paper", 1.0) and PLAIN.label == "paper, slip 1"
    assert asked_for("evaluate", None, None, None) == PLAIN
    other = asked_for("evaluate", None, "laptop_refined", 0.97)
    assert (other.domain, other.slip, other.label) == ("laptop_refined", 0.97, "laptop_refined, slip 0.97")


def test_reference_water_is_labelled_and_refuses_another_domain_or_slip():
    assert asked_for("evaluate", REFERENCE.name, None, None) is REFERENCE
    assert REFERENCE.name in REFERENCE.label and REFERENCE.domain in EVERY and REFERENCE.window in EVERY
    for domain, ratio in (("paper", None), (None, 1.0), (None, 0.0)):
        with pytest.raises(ConfigError, match="beside --reference"):
            asked_for("evaluate", REFERENCE.name, domain, ratio)


@pytest.mark.parametrize("water", REFERENCES.values(), ids=REFERENCES)
def test_a_water_for_judging_swims_freely_on_the_cells_of_its_tank(water):
    tank, window = (water._replace(domain=name).box for name in (water.domain, water.window))
    assert [(a.dx, a.dt) for a in tank.levels] == [(b.dx, b.dt) for b in window.levels]
    assert tank.boxes == window.boxes and window.follows and not tank.follows


def test_the_waters_for_judging_differ_in_label_fingerprint_and_viscosity():
    brain, robot = control.make("dob", load_robot("fish")), load_robot("fish")
    assert [asked_for("evaluate", name, None, None) for name in REFERENCES] == list(REFERENCES.values())
    assert len({run_trials.fingerprint(brain, robot, trials(), water) for water in REFERENCES.values()}) == len(REFERENCES)
    assert REFERENCES["reference-3"].label == "reference-3, paper_refined, Werner-Wengle wall law, boundary wall_stress"
    thick = REFERENCES["low-reynolds"]
    assert thick.label.endswith("viscosity 2e-05 m2/s") and all(level.lattice.nu == 2e-5 for level in thick.box.levels)
    other = PLAIN._replace(nu=2e-5)
    assert run_trials.fingerprint(brain, robot, trials(), other) != run_trials.fingerprint(brain, robot, trials(), PLAIN)
    assert 0.2 * robot.length / thick.nu == pytest.approx(5350, rel=0.01)


def test_a_tank_of_the_engine_has_the_viscosity_of_its_water():
    engine = LbmEngine(load_robot("fish"), [Flow()], domain="laptop", device="cpu", nu=2e-5)
    assert engine.domain.nu == 2e-5
    tiny = replace(preset("laptop"), shape=(52, 32, 20), sponge=4, nu=2e-5)
    assert float(SwimSetup(domain=tiny, device="cpu").run().coupled.fluid.lattice.nu_lu) == pytest.approx(2e-5 * 0.004 / 0.02**2)


def test_chosen_boundary_enters_water_label_and_trial_fingerprint():
    rims = asked_for("evaluate", None, None, 0.98, boundary="rims")
    assert rims.sharpness == Sharpness(rim=1.0) and rims.immersed["sharpness"] == rims.sharpness
    assert rims.label == "paper, slip 0.98, boundary rims" and asked_for("evaluate", None, None, 0.98).label == "paper, slip 0.98"
    with pytest.raises(ConfigError, match="--boundary fins beside --reference"):
        asked_for("evaluate", REFERENCE.name, None, None, boundary="fins")
    brain, robot = control.make("dob", load_robot("fish")), load_robot("fish")
    marks = {run_trials.fingerprint(brain, robot, trials(), PLAIN._replace(sharpness=edge)) for edge in BOUNDARIES.values()}
    assert len(marks) == len(BOUNDARIES) and run_trials.fingerprint(brain, robot, trials(), PLAIN) in marks


def test_half_precision_has_its_own_label_and_fingerprint_and_no_reference():
    half = asked_for("evaluate", None, None, 0.98, storage="float16")
    assert half.label == "paper, slip 0.98, float16" and half.immersed["storage"] == "float16"
    assert "storage" not in asked_for("evaluate", None, None, 0.98, storage="float32").immersed
    brain, robot = control.make("dob", load_robot("fish")), load_robot("fish")
    marks = [run_trials.fingerprint(brain, robot, trials(), PLAIN._replace(storage=kind)) for kind in ("float32", "float16")]
    assert marks[0] != marks[1]
    with pytest.raises(ConfigError, match="--storage float16 beside --reference"):
        asked_for("evaluate", REFERENCE.name, None, None, storage="float16")
    with pytest.raises(ConfigError, match="storage 'float16' in paper_refined, which has finer cells; expected 'float32'"):
        body = ImmersedBody.of("fish", "planar", REFERENCE.box.body_level.dt)
        SwimSetup(domain=REFERENCE.box, storage="float16").assembled(body)


def test_a_boundary_has_its_name_or_says_its_lengths():
    assert [boundary_name(BOUNDARIES[name]) for name in BOUNDARIES] == ["plain", "rims", "fins", "wall_stress"]
    assert BOUNDARIES["fins"] == FINS and boundary_name(Sharpness()) == "plain"
    assert "rim=0.9" in boundary_name(Sharpness(rim=0.9))


def test_a_swims_log_and_a_segments_grid_say_their_boundary():
    tiny = replace(preset("laptop"), shape=(52, 32, 20), sponge=4)
    run = SwimSetup(domain=tiny, device="cpu", sharpness=BOUNDARIES["rims"]).run()
    run.tick([0.0, 0.0, 0.0])
    assert run.trial().value("oracle.boundary") == "rims"
    about = lambda edge: Setup(domain=tiny, device="cpu", sharpness=edge).about["grid"]
    assert about(BOUNDARIES["fins"])["boundary"] == "fins" and "boundary" not in about(BOUNDARIES["plain"])


def test_a_table_of_solver_swims_is_found_by_its_grid_and_boundary():
    assert slip.table_name({"grid": "window"}) == slip.table_name({"grid": "window", "boundary": "plain"}) == "window"
    with pytest.raises(UnknownName, match="window, rims"):
        slip.predictions(slip.table_name({"grid": "window", "boundary": "rims"}), [1.0])


def test_water_of_a_fit_is_that_of_its_segments():
    model = HydroModel.load("swift-reference")
    same = PLAIN._replace(domain="window_coarse_refined", slip=REFERENCE.slip, sharpness=REFERENCE.sharpness)
    assert water_of_fit(model.dataset, model.slip) == same
    plain = HydroModel.load("swift-noslip")
    assert water_of_fit(plain.dataset, plain.slip) == PLAIN._replace(domain="window_coarse", slip=0.0)
    assert water_of_fit(plain.dataset, plain.slip, "laptop").domain == "laptop"
    with pytest.raises(ConfigError, match="boundary soft; expected plain, rims"):
        water_of_fit({"boundary": "soft"}, 1.0)


@pytest.mark.parametrize(("grid", "box"), [({}, PLAIN.window), ({"grid": ""}, PLAIN.window), ({"grid": "window"}, "window")])
def test_all_that_swims_in_the_water_of_a_fit_takes_the_same_box(grid, box, tmp_path, monkeypatch):
    """A fit that names no box has cells of 2 cm, as the shipped segments, in corrections, rankings and the hybrid alike."""

    def refused(verb, device, work, **rest):
        raise UsageError(work[0][0].name)

    monkeypatch.setattr(solver_cost, "agree", refused)
    fit = str(replace(HydroModel.load("swift"), dataset=grid).save(tmp_path))
    assert HybridOptions().solver(in_water(load_robot("fish"), fit)).domain == box
    few = ["--model", fit, "--out", str(tmp_path)]
    asked = Namespace(slip=None, domain=None, rounds=1, device="cpu", yes=False)
    for verb in (
        lambda: rank_waters_command.main(["pd", *few]),
        lambda: dagger.main(["pd", "--data", "data/hydro/tendon_fish", *few]),
        lambda: correct_water.affordable(change(train_preset("quick"), water=fit), asked),
    ):
        with pytest.raises(UsageError, match=f"^{box}$"):
            verb()


def test_reference_is_of_the_solver_alone():
    with pytest.raises(ConfigError, match="--reference: needs --water lbm"):
        evaluate.main(["pd", "--water", "structured", "--reference"])


def test_collect_moves_all_segments_to_the_slip_ratio_of_its_option():
    parser = console.parser("hydro_fit collect", "")
    collect.add_arguments(parser)
    plan_of = lambda *argv: collect.plan_of(parser.parse_args(["--scale", "0.1", *argv]), load_robot("fish"))
    assert plan_of("--all-at-slip", "0.98").label == "scale 0.1, all at slip 0.98"
    for other in (["--reference"], ["--slip", "0.95"]):
        with pytest.raises(ConfigError, match=f"--all-at-slip 0.98 beside {other[0]}"):
            plan_of("--all-at-slip", "0.98", *other)


def test_a_plan_at_another_slip_ratio_has_the_same_episodes_and_splits():
    whole = plans.full("fish", scale=0.1, policies=["dob"])
    moved = whole.moved_to(0.98)
    assert {segment.slip for segment in moved.segments} == {0.98}
    assert moved.episodes == {s.episode: s.split for s in whole.segments if s.slip == plans.DEFAULT_SLIP}
    ids = [segment.id for segment in moved.segments]
    assert len(set(ids)) == len(ids) and all(s.replicate_of in ids for s in moved.segments if s.replicate_of)
    assert moved.label == "scale 0.1, all at slip 0.98"
    rest = lambda plan: {s.id: s.sha256 for s in plan.segments if s.block != "policy"}
    assert rest(plans.planned(moved.label, "fish")) == rest(moved)  # the label says what was moved


@pytest.mark.parametrize("command", ["collect", "calibrate slip"])
def test_free_swims_of_the_reference_name_their_own_window(command):
    """Both swim in the window of the reference, not in the box in which policies are judged."""
    told = f"^{command}: --.* laptop beside --reference, which is reference-2, {REFERENCE.window}, "
    with pytest.raises(ConfigError, match=told):
        if command == "collect":
            collect.main(["--reference", "--domain", "laptop", "--dry-run"])
        else:
            reference_grid("laptop")
    assert reference_grid(None) == (REFERENCE.window, "rims")
