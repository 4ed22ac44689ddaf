"""Which water of the solver is meant: the plain one, the reference, or what options say; and the plans solved in it."""

import pytest

from fishmj.campaign.data import plan as plans
from fishmj.errors import ConfigError
from fishmj.evaluate import __main__ as evaluate
from fishmj.lbm_oracle.run.domain import EVERY
from fishmj.lbm_oracle.run.solver_water import PLAIN, REFERENCE, asked_for


def test_plain_is_the_papers_tank_and_options_change_it():
    assert (PLAIN.domain, PLAIN.slip) == ("paper", 1.0) and PLAIN.label == "paper, slip 1"
    assert asked_for("evaluate", False, None, None) == PLAIN
    other = asked_for("evaluate", False, "laptop_refined", 0.97)
    assert (other.domain, other.slip, other.label) == ("laptop_refined", 0.97, "laptop_refined, slip 0.97")


def test_the_reference_is_named_in_its_label_and_refuses_another_box_or_slip():
    assert asked_for("evaluate", True, None, None) is REFERENCE
    assert REFERENCE.name in REFERENCE.label and REFERENCE.domain in EVERY and REFERENCE.window in EVERY
    for domain, slip in (("paper", None), (None, 1.0), (None, 0.0)):
        with pytest.raises(ConfigError, match="beside --reference"):
            asked_for("evaluate", True, domain, slip)


def test_the_reference_swims_freely_on_the_cells_of_its_tank():
    tank, window = (REFERENCE._replace(domain=name).box for name in (REFERENCE.domain, REFERENCE.window))
    assert [(a.dx, a.dt) for a in tank.levels] == [(b.dx, b.dt) for b in window.levels]
    assert tank.boxes == window.boxes and window.follows and not tank.follows


def test_reference_is_of_the_solver_alone():
    with pytest.raises(ConfigError, match="--reference: of --water lbm only"):
        evaluate.main(["pd", "--water", "structured", "--reference"])


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
