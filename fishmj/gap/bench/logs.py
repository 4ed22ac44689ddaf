"""Cases of measured logs: a term that a robot's own records need is deleted from its fitted model, and the search looks for it.

    full model     baseline of a public set (`measured/`), and the effect that its records name
    single         one term of the full model deleted: a constant at zero and no longer fitted, or the effect
    none           nothing deleted
    truth          the term's value in the full model, fitted to all records of the search
    true_gap       1 + (error without the term - error of the full model) / floor, all constants refitted both times

Every case draws anew the conditions, or the trajectory, that are kept aside. Only terms that are an effect of the catalogue,
formula for formula, can be deleted: with the few public sets that makes few cases. Other errors of a real robot's model remain.
"""

import time
from typing import NamedTuple

import numpy as np

from fishmj.gap.bench.run_case import answered_by
from fishmj.gap.measured.study import Study, extended, investigate
from fishmj.gap.measured.study_answer import answer
from fishmj.gap.measured.study_build import built, deleted, shipped
from fishmj.gap.verdict import Verdict

TERMS = {  # set: what its full model has beyond the baseline, and what can be deleted: effect -> (constant, parameter)
    "tail_fish": (("body_lift",), {"body_lift": ("", "coefficient"), "yaw_drag": ("yaw_drag", "coefficient"), "": ("", "")}),
    "servo_xl330": (("load_friction",), {"load_friction": ("", "ratio"), "viscous_friction": ("viscous", "damping")}),
}


class Deletion(NamedTuple):
    """One case. term: deleted effect, "" for none."""

    id: str
    kind: str
    set: str
    term: str
    seed: int


def draw(count: int, seed: int) -> list[Deletion]:
    """Draws `count` cases: every term of every set before one comes up twice, each time with other records kept aside."""
    deck = [(name, term) for name, (_, terms) in TERMS.items() for term in terms]
    chosen = [(*deck[i % len(deck)], seed + i // len(deck)) for i in range(count)]
    return [Deletion(f"log-{s}-{t or 'nothing'}-{k}", "single" if t else "none", s, t, k) for s, t, k in chosen]


TRAJECTORIES = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")  # of the servo's set, in alphabetical order


def split_study(case: Deletion, without: str = "") -> Study:
    """The set split by the case's seed, with a constant deleted from its baseline."""
    changes = deleted(case.set, without) if without else {}
    if case.set == "tail_fish":
        return built(shipped(case.set, changes | {"search": {"seed": case.seed}}))
    kept = TRAJECTORIES[case.seed % len(TRAJECTORIES)]
    return built(shipped(case.set, changes | {"held_out": {"where": {"rig.trajectory": kept}}}))


def run(case: Deletion) -> dict:
    """One row of the benchmark."""
    start = time.monotonic()
    beyond, terms = TERMS[case.set]
    constant, parameter = terms[case.term]
    whole = split_study(case)
    full = extended(whole, beyond)
    study, has = split_study(case, constant), tuple(name for name in beyond if name != case.term)
    found = investigate(study, most=2, has=has)
    verdict = answer(study, found)
    truth = {case.term: {parameter: value(whole, full.row, case.term, constant, parameter)}} if case.term else {}
    apart = study.error(study.learn, found.base.row) - whole.error(whole.learn, full.row)
    gap = 1.0 + max(apart, 0.0) / study.floor if case.term else 1.0
    row: dict = {"id": case.id, "kind": case.kind, "set": case.set, "truth": truth, "seed": case.seed, "noise": 1.0}
    row |= {"logs": len(study.learn), "true_gap": gap, "beyond_gap": gap, "each_gap": dict.fromkeys(truth, gap)}
    return row | verdict_row(verdict) | {"seconds": time.monotonic() - start}


def verdict_row(verdict: Verdict) -> dict:
    """Entries of a row on the verdict, in the form of the other generators."""
    return answered_by(verdict) | {"gap_unseen_before": verdict.gap_before, "reason": verdict.reason}


def value(study: Study, row: np.ndarray, effect: str, constant: str, parameter: str) -> float:
    """Value of the deleted term in the full model, SI."""
    if not constant:
        return float(row[study.plant.index(effect, parameter)])
    place = [c.name for c in study.plant.constants].index(constant)
    nominal = study.plant.hull if hasattr(study.plant, "hull") else study.plant.motor
    return float(row[place] * getattr(nominal, constant))
