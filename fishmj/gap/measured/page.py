"""report.html of a study: the answer, the error of each group left out, the candidates, the basis of the words."""

import numpy as np

from fishmj.base import pages
from fishmj.base.figures import canvas, style, svg
from fishmj.base.pages import Section, drawn, figure, part, table
from fishmj.gap.measured.significance import LEAST_GROUPS, LEVEL, smallest_p
from fishmj.gap.measured.study import SelectionRound, Study, StudyOutcome
from fishmj.gap.measured.study_answer import TOO_FEW, left_out, unseen_text, where
from fishmj.gap.measured.study_schema import StudyInput
from fishmj.gap.report.pictures import AFTER, BEFORE, QUIET, STYLE
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import level, number, percent, quantity, sizes, title

MEANING = {
    "NAMED": "One term lowers the error of held-out groups, and no other does so as well.",
    "CLASS": "Something is missing, and these records cannot tell which of the listed terms it is.",
    "UNEXPLAINED": "The model lacks something that no candidate term certainly explains.",
    "AGREES": "The model agrees with the records within the sensors' noise.",
    "NOT_REPEATABLE": "The records differ from each other as much as from the model.",
    TOO_FEW: "Too few groups to decide: the listed terms are hypotheses for the next experiment, not findings.",
}
SHOWN = 40  # groups in the picture


def html(given: StudyInput, study: Study, found: StudyOutcome, v: Verdict, figures: dict) -> str:
    """The page as one text without outside references."""
    with style(STYLE):
        sections = [answer(study, v), groups(study, found), *(candidates(r) for r in found.rounds), sure(study)]
        sections += [others(figures), records(study)]
    heading = f"{study.name}: {', '.join(title(e.name) for e in v.effects) or 'nothing named'}"
    notes = [MEANING[v.answer]]
    notes += [given.given.about] if given.given.about else []
    notes += ["Synthetic data, computed and not measured."] if study.origin == "synthetic" else []
    return pages.report(f"{v.answer}: {study.name}", heading, sections, mark=v.answer.replace("_", " "), notes=notes)


def answer(study: Study, v: Verdict) -> Section:
    """Section with the verdict and its reason."""
    tentative = "tentative: " if v.answer in ("UNEXPLAINED", TOO_FEW) else ""
    rows = [
        {"term": part("strong", title(e.name)), "parameter": title(k), "value": quantity(p.value, p.unit, p.low, p.high)}
        for e in v.effects
        for k, p in e.parameters.items()
    ]
    found = [f"{tentative}{sizes(e.name, e.parameters)}" for e in v.effects]
    rivals = [f"possible instead: {', '.join(title(r['name']) for r in v.rivals)}"] if v.rivals else []
    gap = f"gap {level(v.gap_before)} to {level(v.gap_after)} {where(study)}, in units of the floor; 1 is agreement"
    gap += f" (floor: {study.floor_of})"
    warned = [part("told", w, "warn") for w in v.warnings]
    about = f"{v.reason[:1].upper()}{v.reason[1:]}. Intervals: 90 %, jackknife over the folds."
    return Section("The answer", about, [part("items", [*found, *rivals, gap]), table(rows, left=2), *warned])


def groups(study: Study, found: StudyOutcome) -> Section:
    """Section with every group, predicted without it."""
    u = left_out(study, found)
    unit = study.unit or "mean square"
    taken = any(r.accepted for r in found.rounds)
    rows = []
    for name, (before, after) in u["each"].items():
        row: dict = {"group": name, f"before [{unit}]": before}
        rows.append(row | ({f"after [{unit}]": after, "ratio": after / before if before else None} if taken else {}))
    about = f"{unseen_text(study, found)[:1].upper()}{unseen_text(study, found)[1:]}. Each group counts once."
    shown = figure(_dots(u["each"], taken)) if len(u["each"]) <= SHOWN else ""
    return Section("Groups that were left out", about, [shown, table(rows)])


def _dots(each: dict, taken: bool):
    fig, axes = canvas(1, 1, (6.2, 0.28 * len(each) + 0.9))
    axis = axes[0, 0]
    at = np.arange(len(each))[::-1]
    values = np.array(list(each.values()))
    before, after = values.T / max(float(values[:, 0].mean()), 1e-300)
    axis.plot(before, at, "s", color=BEFORE, label="the model as it was")
    if taken:
        axis.hlines(at, before, after, color=QUIET, linewidth=0.8)
        axis.plot(after, at, "o", color=AFTER, label="with what was found")
    axis.set_yticks(at, [drawn(name) for name in each])
    axis.set_xlim(left=0.0)
    axis.set_xlabel("error, of the mean before")
    axis.legend(loc="best")
    return svg(fig, "error of each group that was left out, before and after")


def candidates(r: SelectionRound) -> Section:
    """Section with one round's table."""
    name = r.fitted.names[-1]
    start = r.before.sum()
    rows = []
    for i in np.argsort(r.cost.sum(1)):
        other = r.names[i]
        better = int(np.sum(r.cost[r.names.index(name)] < r.cost[i]))
        against = "-" if other == name else f"{r.p_rival[other]:.2g} ({better} of {len(r.groups)})"
        row: dict = {"term": part("strong", title(other)) if other == name else title(other)}
        row |= {"cost left out": number(float(r.cost[i].sum() / start)), "P(best)": f"{r.p_best[other]:.2f}"}
        rows.append(row | {"best in folds": str(r.best.count(other)), "p of the best against it": against})
    taken = "taken into the model" if r.accepted else "not taken"
    about = (
        f"{title(name)[:1].upper()}{title(name)[1:]} was {taken}: P(useful) = {r.useful:.2f} by the bootstrap over groups (0.95"
        f" is needed), exact p = {r.p_exact:.2g} ({LEVEL:g} is needed). Cost: |z|^2 left out, of the model before."
        " p: exact test over the groups; in brackets how many are better with the best than with this one."
    )
    return Section(f"Candidates: {title(name)}", about, [table(rows)])


def sure(study: Study) -> Section:
    """Section on the certainty that so many groups allow."""
    n = len(study.groups)
    items = [
        f"{n} groups in {len(set(study.fold))} folds: the smallest possible p of a test over them is {smallest_p(n):.2g}",
        f"With fewer than {LEAST_GROUPS} groups there is no verdict; the answer follows the weaker of bootstrap and exact test",
        f"For conditions outside these {n} groups, the table above is the only evidence",
        "Folds share most of their records, so groups are not quite independent and p is somewhat too small",
    ]
    return Section("Significance with this many groups", "", [part("items", items)])


def others(figures: dict) -> Section:
    """Section on the variants."""
    rows = [
        {
            "variant": label,
            "found": title(v["found"]),
            "": "accepted" if v["accepted"] else "rejected",
            "ratio": percent(v["ratio"]),
        }
        for label, v in figures.get("variants", {}).items()
    ]
    return Section("The same search with", "One round each; the ratio is after to before.", [table(rows, left=3)] if rows else [])


def records(study: Study) -> Section:
    """Section on the used records."""
    return Section("Records", "", [part("items", [*study.protocol, *study.notes])])
