"""The answer in words: what it says, what it means, what to do next, and each gate as a question."""

from typing import NamedTuple

from fishmj.effects import catalogue
from fishmj.effects.effect import Effect
from fishmj.gap.report.report_data import ReportData
from fishmj.gap.search.model_error import misformed
from fishmj.gap.terms.stronger import outdone
from fishmj.gap.thresholds import residual_allowed, thresholds
from fishmj.gap.verdict import LIKELIHOOD, Verdict
from fishmj.gap.wording import level, number, percent, title

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"  # candidates, in tables and maps
CONTRACT = {
    "AGREES": "Nothing differs beyond what the model leaves open.",
    "NAMED": "One effect explains it, on records that it was not fitted to.",
    "CLASS": "It is one of a few; an experiment is proposed that decides.",
    "UNEXPLAINED": "Something is missing that the catalogue does not hold.",
    "NOT_REPEATABLE": "The records differ from each other as much as from the model.",
}


class Gate(NamedTuple):
    """One row of the table. state: passed, failed, or not asked."""

    name: str
    question: str
    value: str
    needed: str
    state: str


def headline(v: Verdict) -> str:
    """The answer in a few words."""
    names = [title(e.name) for e in v.effects]
    if v.answer == "NAMED":
        return f"Missing: {' and '.join(names)}"
    if v.answer == "CLASS":
        others = list(dict.fromkeys(title(str(r["name"])) for r in v.rivals))
        found = " and ".join(names)
        return f"Missing: {' or '.join([found, *others])}" if others else f"Perhaps {found}, a stand-in"
    if v.answer == "UNEXPLAINED":
        return "Something is missing that the catalogue does not explain"
    if v.answer == "NOT_REPEATABLE":
        return "The records do not repeat themselves"
    return "Model and records agree"


def meaning(m: ReportData) -> str:
    """One sentence on what it means."""
    v = m.inquiry.verdict
    known = {e.name: e for e in m.inquiry.evidence.model.active.effects}
    if v.answer == "NAMED":
        about = "; ".join(_about(known[e.name]) for e in v.effects if e.name in known)
        return f"{about[:1].upper()}{about[1:]}. With it the model {v.told()}."
    if v.answer == "CLASS":
        return f"{sentence(v.reason)} The first {v.told()}."
    if v.answer == "UNEXPLAINED":
        tentative = f" Do not add {' and '.join(title(e.name) for e in v.effects)} yet." if v.effects else ""
        return f"{sentence(v.reason)}{tentative}"
    if v.answer == "NOT_REPEATABLE":
        return f"{sentence(v.reason)} There is nothing to name: turbulence, placing or noise."
    return f"{sentence(v.reason)}"


def next_step(m: ReportData) -> str:
    """One sentence on what to do."""
    v = m.inquiry.verdict
    if v.next_experiment:
        return v.next_experiment
    if v.answer == "NAMED":
        return "Write it into the model with fishmj gap apply, and run the records again."
    if v.answer == "CLASS" and v.effects:
        known = catalogue()
        for r in v.rivals:
            said = separation(known, v.effects[-1].name, str(r["name"]))
            if said:
                return said
        return "Ask fishmj gap next for the experiment that tells them apart."
    if v.answer == "UNEXPLAINED" and v.terms and v.terms[0]["firm"]:
        first = v.terms[0]
        share = f"it takes {percent(first['closure'])} of the excess of |z|² off them"
        return f"Look for what makes a force like this: {first['name']} (below). Fitted to these records {share}."
    if v.answer == "UNEXPLAINED":
        return "Look at where the residual lies (below), and repeat the most telling record to make sure that it repeats."
    if v.answer == "NOT_REPEATABLE":
        return "Record more replicates in still water, or find what changes between them."
    if m.blind:
        return f"Nothing to add. These records would not have shown {len(m.blind)} of the effects in question (listed below)."
    return "Nothing to add."


def separation(known: dict[str, Effect], a: str, b: str) -> str:
    """What tells two effects apart, from the catalogue; "" when it does not say."""
    for one, two in ((a, b), (b, a)):
        for c in known[one].confusions if one in known else ():
            if c.other == two:
                runs = f"Record {', '.join(c.excitations)}: " if c.excitations else ""
                return f"{runs}{title(one)} and {title(two)} differ in that {c.separates}."
    return ""


def gates(m: ReportData) -> list[Gate]:
    """Every gate with its figure and its threshold; after the first that stops the search, none is asked."""
    v, g, first = m.inquiry.verdict, m.gates, m.inquiry.found.steps[0] if m.inquiry.found.steps else None
    checks, accepted = v.gates, bool(first and first.accepted)
    had = lambda key: float(checks.get(key, float("nan")))
    p, rivals = min((e.p_best for e in v.effects), default=0.0), len(v.rivals)
    rows = (
        ("gap", "Is there more than null runs reach?")
        + (level(had("adequacy")), f"> {g.adequacy:g}", had("adequacy") > g.adequacy or accepted),
        ("gain", "Does the best effect make records that did not see it likelier than chance does?")
        + (number(first.gain if first else 0.0), f"> {g.gain:g}", accepted),
        ("closure", f"Is most of {LIKELIHOOD} gone, unseen?")
        + (percent(had("closure")), f"≥ {percent(g.closure)}", had("closure") >= g.closure),
        ("rest", "Is what is left within the error of any formula?")
        + (level(had("rest")), f"≤ {residual_allowed(checks, g):.3g}", had("rest") <= residual_allowed(checks, g)),
        ("form", "Is it right to within what a formula may be wrong?")
        + (percent(had("form")), f"≤ {percent(g.form)}", not misformed(checks)),
        ("size", "And in its size, from record to record?")
        + (percent(had("size")), f"≤ {percent(g.size)}", had("size") <= g.size),
        ("transfer", "Do the records get likelier one by one, unseen?")
        + (percent(had("transfer")), f"≥ {percent(g.transfer)}", had("transfer") >= g.transfer),
        ("uniqueness", "Is no other effect nearly as good?")
        + (f"P(best) {p:.2f}, rivals {rivals}", f"≥ {g.p_best:g}, none", not rivals and p >= g.p_best),
        ("sanity", "Are the values believable?") + (f"{len(v.warnings)} warnings", "none", not v.warnings),
        ("force", "Does no free force that is right in its form explain more, unseen?")
        + (number(had("lead")) if "lead" in checks else "-", f"≤ {number(thresholds().stronger.lead)}", not outdone(checks)),
    )
    out, asked = [], True
    if v.answer == "NOT_REPEATABLE":
        question = "Do records of one experiment agree better with each other than with the model?"
        out, asked = [Gate("replicates", question, "no", "yes", "failed")], False
    for name, question, value, needed, passed in rows:
        state = ("passed" if passed else "failed") if asked else "not asked"
        out.append(Gate(name, question, value if asked else "-", needed, state))
        asked = asked and passed
    return out


def _about(effect: Effect) -> str:
    return effect.about.rstrip(".")


def sentence(text: str) -> str:
    """With a capital and a full stop."""
    return text[:1].upper() + text[1:].rstrip(".") + "." if text else ""
