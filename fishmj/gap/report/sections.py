"""The page, from top to bottom: the answer in words, then its basis."""

import re
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from fishmj.base import pages
from fishmj.base.figures import style
from fishmj.base.pages import Section, figure, part, table
from fishmj.effects import catalogue
from fishmj.effects.effect import Effect
from fishmj.gap.localise.narrative import nothing
from fishmj.gap.localise.swimming_speed import speeds_text
from fishmj.gap.report import pictures
from fishmj.gap.report.pictures import STYLE, letter, traces
from fishmj.gap.report.report_data import ReportData, RoundFinalists, gap_of, record_parts
from fishmj.gap.search.model_error import misformed
from fishmj.gap.terms.stronger import is_outdone
from fishmj.gap.thresholds import residual_allowed, thresholds
from fishmj.gap.verdict import LIKELIHOOD, UP_TO, Verdict, missed_words
from fishmj.gap.wording import level, number, percent, quantity, sentence, sizes, title
from fishmj.mjcf.identity import robot_line

NOTHING = Section("", "", ())
UNMET, ACCEPTED = "not met; continued", "an effect was accepted"
SET_ON = "Thresholds were set on null runs and planted effects; the benchmarks use other data."


def html(m: ReportData) -> str:
    """The whole page as one text."""
    with style(STYLE):
        sections = [gap(m), where(m), trace_section(m), growth(m), candidates(m), forces(m), checks(m), invisible(m), records(m)]
    return page_of(m, sections, robot_line(m.inquiry.evidence.model.robot), next_step(m), "records", "report.json")


def page_of(m: ReportData, sections: list[Section], robot: str, step: str, searched: str, json: str) -> str:
    """The page of some sections. robot: its line. step: the next one. searched: word for the logs. json: file of the figures."""
    v, e = m.inquiry.verdict, m.inquiry.evidence
    made = f"gap find · {len(e.records)} {searched} in the search, {e.runs} null runs of each"
    head = {"robot": robot, "synthetic": m.inquiry.synthetic, "value": value(m), "meaning": escape_text(meaning(m))}
    head |= {"next_step": escape_text(step), "figures": figures(m), "contract": CONTRACT, "made": made, "json": json}
    return pages.report(headline(v), headline(v), sections, "gap.html", mark=v.answer, **head)


def value(m: ReportData) -> str:
    """The found effect with its interval; "" without one."""
    v = m.inquiry.verdict
    if not v.effects:
        return ""
    tentative = v.answer == "UNEXPLAINED"
    shown = " · ".join(sizes(n.name, n.parameters, len(v.effects) == 1 and not tentative) for n in v.effects)
    doubts = "".join(f". {sentence(doubt)[:-1]}" for e in v.effects for doubt in v.doubts(e))
    if tentative:
        return part("told", f"tentative: {shown}{doubts}", "small")
    return part("told", pages.escaped(f"{shown} ") + part("small", f"90\u00a0% interval{doubts}"), "value")


def figures(m: ReportData) -> list[tuple[str, str]]:
    """The few most important numbers."""
    v = m.inquiry.verdict
    before, after = gap_of(m)
    about = f"gap of the records searched; {v.yardstick()}"
    out = []
    if m.comparison.changed:
        out.append((f"{level(before)} → {level(after)}", about))
        if v.shrinks:
            out.append((f"{percent(v.explained)}", f"of {LIKELIHOOD} is explained, on held-out records"))
    else:
        out.append((level(before), about))
    if v.answer in ("NAMED", "CLASS") and v.effects:
        out.append((f"{min(e.p_best for e in v.effects):.2f}", "P(best): share of bootstrap draws that it wins"))
    seconds, effects = sum(r.seconds for r in m.inquiry.records), len(m.inquiry.evidence.model.active.effects)
    out.append((f"{len(m.inquiry.records)}", f"records, {seconds:.0f} s; {effects} effects in question"))
    return out


def gap(m: ReportData) -> Section:
    """Section on the gap before and after."""
    pair = lambda both: " → ".join(map(level, both if m.comparison.changed else both[:1]))
    shown_rows = {"all": gap_of(m), **m.channels}
    rows: list[dict] = [{"channel": part("strong", "all"), "gap": part("strong", pair(shown_rows["all"]))}]
    rows += [{"channel": k, "gap": pair(both)} for k, both in m.channels.items()]
    about = "|z|² / m: mean square of measured minus model, whitened by the covariance of healthy robots, so that "
    about += f"these have about 1, rarely more than {level(m.gates.adequacy)}: up to there model and records agree. "
    if m.comparison.changed:
        about += "Square: present model. Circle: with the found effects. "
    about += "Grey: agreement."
    drawn = figure(pictures.gaps(shown_rows, m.comparison.changed, m.gates.adequacy))
    shown = part("beside", drawn, table(rows), "two")
    return Section("The gap" + (", before and after" if m.comparison.changed else ""), about, [shown, *warnings(m)])


def warnings(m: ReportData) -> list[str]:
    """Reasons for caution, before anything else is read."""
    notes = list(m.inquiry.verdict.warnings)
    for n in m.inquiry.verdict.tentative if m.inquiry.verdict.taken else ():
        notes.append(f"{title(n.name)} also helped a little, but may be an error of another effect: it is fitted but not named")
    if m.comparison.changed and not m.inquiry.verdict.shrinks:
        notes.append(f"The found effect {m.inquiry.verdict.success_text()}")
    shown: list[str] = [part("told", escape_text(n.rstrip(".") + "."), "warn") for n in notes]
    shown += m.inquiry.notes  # escaped, because they contain file names
    shown += [sentence(text) for text in m.inquiry.verdict.unseen()]
    if not m.inquiry.unseen.any():
        shown.append("No record was set aside for a final check: that needs nine records or more.")
    return shown


def where(m: ReportData) -> Section:
    """Section on the localisation."""
    p = m.place
    by_form = "The effect was found by the form of the residual, not by its size." if m.inquiry.verdict.taken else ""
    text = part("told", escape_text(" ".join(filter(None, (p.text, by_form if nothing(p) else "", m.weighed)))), "place")
    if nothing(p):
        return Section("Where it is", "", [text])
    detail = pictures.details(p, m.comparison.changed)
    about = "The residual of the present model, before any effect is added."
    keys = (
        "Each cell: its share of the gap beyond 1, and its mean z². Every half second counts once."
        " Grey in the left panel: lags within a servo's tolerance."
    )
    return Section("Where it is", about, [text, figure(pictures.heat(p)), figure(detail) if detail else "", keys])


def trace_section(m: ReportData) -> Section:
    """Section with the traces."""
    use = [used for used, unseen in zip(record_parts(m.inquiry), m.inquiry.unseen, strict=True) if not unseen]
    about = "The records with most of the gap, one for each channel. The model runs freely from the measured start."
    return Section("The records that tell most", about, [figure(traces(m.comparison, use))])


def growth(m: ReportData) -> Section:
    """Section with the growth curves."""
    if not m.growth:
        return NOTHING
    about = (
        f"The model is restarted from the measured state {m.growth[0].restarts} times, and runs freely for up to three seconds."
        " Slope 0: present at once (a sensor, a delay, an actuator); 1: grows like a velocity (current); 2: like a force"
        " (drag, thrust). Grey: error from the uncertainty of the start."
    )
    return Section("How it grows", about, [figure(pictures.growth(m.growth, m.comparison.changed))])


def candidates(m: ReportData) -> Section:
    """Section with ranked tables and confusion maps."""
    if not m.rounds:
        return NOTHING
    about = (
        "The finalists, fitted to all searched records, by P(best): the share of bootstrap draws over records that an effect"
        " wins, with the covariance linearised at the tried one. Behind: twice the log likelihood by which it trails the tried"
        " one, each linearised at itself, as a share of that one's gain; negative if it is likelier."
        " Values are those of the round; the values at the head of the page were refitted with all accepted effects."
        " The map shows the cosine between the whitened responses of the first 16: near 1 these records can hardly tell"
        " them apart."
    )
    name = "What came closest" if m.inquiry.verdict.answer == "AGREES" else "What it could be"
    blocks = [ranked(r, i, len(m.rounds)) for i, r in enumerate(m.rounds)]
    rounds = [step.text() for step in m.inquiry.found.steps]
    return Section(name, about, [*blocks, part("heading", "Rounds"), part("items", rounds)])


def forces(m: ReportData) -> Section:
    """Section that describes the gap as a force, if no effect explains it."""
    rows = []
    for t in m.inquiry.verdict.terms:
        alike = [part("small", f"or {', '.join(t['alike'][:3])}")] if t["alike"] else []
        row: dict[str, str] = {"term": part("lines", [part("strong", t["name"]), *alike])}
        row |= {"coefficient": f"{number(t['coefficient'])} {t['unit']}", "removes": percent(t["closure"])}
        rows.append(row | {"chosen in": percent(t["stability"]), "": part("tag", "firm" if t["firm"] else "weak")})
    about = (
        "Forces and torques as products of the robot's states, the largest gain on unseen records first. They describe what is"
        " missing but do not name it. Removes: share of the excess |z|² over that of healthy robots,"
        " on the records that it was fitted to. Chosen in: share of half-samples of the records in which a term is among the"
        " first two. Firm: it passes every test."
    )
    return Section("As a force", about, [table(rows)])


def ranked(r: RoundFinalists, place: int, count: int) -> str:
    """Table of one round."""
    rows = []
    for i, row in enumerate(r.table):
        name = part("letter", letter(i), title(row.name)) + (part("tag", "rival") if row.rival else "")
        values = [f"{title(k)} {quantity(*x)}".replace(" ", "\u00a0") for k, x in row.values.items()]
        share = part("small", "on a bound: no rival") if row.p_best is None else part("bar", row.p_best)
        behind = "tried" if row.tried else "-" if row.behind is None else f"{number(100 * row.behind)} %"
        rows.append({"effect": name, "in its round": part("lines", values), "P(best)": share, "behind": behind})
    drawn = figure(pictures.confusion(r)) if len(r.table) > 1 else ""
    head = part("heading", f"Effect {place + 1}") if count > 1 else ""
    return head + part("beside", table(rows, left=3), drawn, "rank")


def checks(m: ReportData, about: str = SET_ON) -> Section:
    """Section on the gates. about: on what their thresholds were set."""
    rows = [
        {
            "gate": part("strong", g.name),
            "question": g.question,
            "found": g.value,
            "needed": g.needed,
            "": part("tag", g.state.partition(";")[0], g.state),
        }
        for g in gates(m)
    ]
    return Section("Why this answer", about, [table(rows, left=2)])


def invisible(m: ReportData) -> Section:
    """Section on the effects that these records could not show, and with AGREES on the sizes that they could have missed."""
    items = [pages.escaped(f"{title(b.name)} ") + part("small", b.typical) for b in m.blind]
    about = (
        "At their typical size these effects change the records too little to be named, so nothing is known about them. Other"
        " experiments may show them (fishmj gap next)."
    )
    shown: list[str] = [about, part("items", items, "columns")] if items else []
    up_to, never = missed_words(m.inquiry.verdict.missed)
    shown += [f"{sentence(UP_TO)[:-1]}, the least detectable first:", part("items", up_to)] if up_to else []
    shown += [f"Not excluded at any size that was tried: {', '.join(never)}."] if never else []
    return Section("What these records cannot show", "", shown)


def records(m: ReportData) -> Section:
    """Section on the used records."""
    use = dict(zip([r.name for r in m.inquiry.records], record_parts(m.inquiry), strict=True))
    found = []
    for i, r in enumerate(m.comparison.records):
        some = m.comparison.layout.record == i
        before, after = (float(np.mean(x[some])) for x in m.comparison.ratio)
        found.append((r, f"{level(before)} → {level(after)}" if m.comparison.changed else level(before)))
    found += [(r, "-") for r, u in zip(m.inquiry.records, m.inquiry.unseen, strict=True) if u]
    said = {r.name: [f"{v:.3f}" for v in m.speeds.get(r.name, ())] or ["-", "-"] for r, _ in found} if m.speeds else {}
    rows = [
        {"record": part("strong", r.name), "experiment": r.excitation, "use": use[r.name], "length": f"{r.seconds:.1f} s"}
        | {"mean z²": pair}
        | ({"m/s measured": said[r.name][0], "m/s model": said[r.name][1]} if said else {})
        for r, pair in found
    ]
    return Section("The records", sentence(speeds_text(m.speeds)), [table(rows, left=3)])


def escape_text(text: str) -> Markup:
    """Escapes a text, marks `code` as code, and keeps units off the start of a line."""
    text = re.sub(r"(\d)%", r"\1 %", text)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(pages.escaped(text)))  # of a Markup, re.sub would escape the tag, too
    return Markup(re.sub(r"(\d) (%|ms|s|deg|mm|W)\b", "\\1\u00a0\\2", text).replace(" %", "\u00a0%"))


CONTRACT = {
    "AGREES": "The model agrees with the records within its uncertainty.",
    "NAMED": "One effect explains the gap, on records that it was not fitted to.",
    "CLASS": "The cause is one of a few effects, which the proposed experiment tells apart, or has an implausible value.",
    "UNEXPLAINED": "Something is missing that no effect of the catalogue certainly explains.",
    "NOT_REPEATABLE": "The records differ from each other as much as from the model.",
}


class Gate(NamedTuple):
    """One row of the table. state: passed, failed, not tested, or not met, with the reason why the search continued."""

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
    if v.implausible:
        return f"Implausible value: perhaps {' and '.join(names)}, or something that it imitates"
    if v.answer == "CLASS":
        others = list(dict.fromkeys(title(str(r["name"])) for r in v.rivals))
        found = " and ".join(names)
        if len(v.effects) == 1 and others:  # the likeliest first
            found, *others = dict.fromkeys(title(name) for name, _ in v.standing(v.effects[0]))
        return f"Missing: {' or '.join([found, *others])}" if others else f"Perhaps {found}, or something that it imitates"
    if v.answer == "UNEXPLAINED":
        return "Something is missing that no effect certainly explains"
    if v.answer == "NOT_REPEATABLE":
        return "The records are not repeatable"
    return "Model and records agree"


def meaning(m: ReportData) -> str:
    """One sentence on the meaning of the answer."""
    v = m.inquiry.verdict
    known = {e.name: e for e in m.inquiry.evidence.model.active.effects}
    if v.answer == "NAMED":
        about = "; ".join(known[e.name].about.rstrip(".") for e in v.effects if e.name in known)
        return f"{about[:1].upper()}{about[1:]}. With it the model {v.success_text()}."
    if v.answer == "CLASS":
        return f"{sentence(v.reason)} The first {v.success_text()}."
    if v.answer == "UNEXPLAINED":
        tentative = f" Do not add {' and '.join(title(e.name) for e in v.effects)} yet." if v.effects else ""
        return f"{sentence(v.reason)}{tentative}"
    if v.answer == "NOT_REPEATABLE":
        return f"{sentence(v.reason)} The cause is turbulence, placement or noise, not the model."
    return sentence(v.reason)


def next_step(m: ReportData) -> str:
    """One sentence on the next step."""
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
        share = f"it removes {percent(first['closure'])} of the excess |z|²"
        return f"Look for the cause of a force like this: {first['name']} (below). Fitted to these records {share}."
    if v.answer == "UNEXPLAINED":
        return "Look at where the residual is (below), and repeat the most informative record to test that it is repeatable."
    if v.answer == "NOT_REPEATABLE":
        return "Record more replicates in still water, or find what changes between them."
    if m.blind:
        return f"Nothing to add. These records cannot show {len(m.blind)} of the searched effects (listed below)."
    return "Nothing to add."


def separation(known: dict[str, Effect], a: str, b: str) -> str:
    """Difference between two effects, from the catalogue; "" if it states none."""
    for one, two in ((a, b), (b, a)):
        for c in known[one].confusions if one in known else ():
            if c.other == two:
                runs = f"Record {', '.join(c.excitations)}: " if c.excitations else ""
                return f"{runs}{title(one)} and {title(two)} differ in that {c.separates}."
    return ""


def gates(m: ReportData) -> list[Gate]:
    """Every gate with its value and its threshold; gates after the first one that stops the search are not tested."""
    v, g, first = m.inquiry.verdict, m.gates, m.inquiry.found.steps[0] if m.inquiry.found.steps else None
    checks, accepted = v.gates, bool(first and first.accepted)
    had = lambda key: float(checks.get(key, float("nan")))
    p, rivals = min((e.p_best for e in v.effects), default=0.0), len(v.rivals)
    doubts = 0 if v.answer == "NAMED" else len(v.warnings)  # warnings of a NAMED answer do not concern its value
    gained, little = first.gain if first else 0.0, had("rest") <= (1.0 + g.adequacy) / 2
    lead, most = had("lead") if "lead" in checks else 0.0, thresholds().stronger.lead
    # (gate, question, found, needed, whether it holds, why the search goes on where it does not)
    rows = (
        ("gap", "Is the gap larger than in null runs?")
        + (level(had("adequacy")), f"> {g.adequacy:g}", had("adequacy") > g.adequacy)
        + (ACCEPTED if accepted else "",),
        ("gain", "Does the best effect raise the likelihood of unseen records by more than chance?")
        + (number(gained), f"> {g.gain:g}", accepted and gained > g.gain)
        + ("its gain on all records at once is enough" if accepted else "",),
        ("closure", f"Does it explain most of {LIKELIHOOD} of unseen records?")
        + (percent(had("closure")), f"≥ {percent(g.closure)}", had("closure") >= g.closure)
        + ("the remaining residual is small" if little else "",),
        ("rest", "Is the rest within the error of a correct formula?")
        + (level(had("rest")), f"≤ {residual_allowed(checks, g):.3g}", had("rest") <= residual_allowed(checks, g), ""),
        ("form", "Is its formula accurate enough?")
        + (percent(had("form")), f"≤ {percent(g.form)}", had("form") <= g.form and not misformed(checks))
        + ("" if misformed(checks) else "it may be chance, or only an exact value fits",),
        ("size", "Is its size the same in all records?")
        + (percent(had("size")), f"≤ {percent(g.size)}", had("size") <= g.size, ""),
        ("transfer", "Does the likelihood rise in most unseen records?")
        + (percent(had("transfer")), f"≥ {percent(g.transfer)}", had("transfer") >= g.transfer, ""),
        ("uniqueness", "Is no other effect nearly as good?")
        + (f"P(best) {p:.2f}, rivals {rivals}", f"≥ {g.p_best:g}, none", not rivals and p >= g.p_best, ""),
        ("sanity", "Are the values plausible?") + (f"{doubts} warnings", "none", not doubts, ""),
        ("force", "Does no free force of correct form explain unseen records better?")
        + (number(lead) if "lead" in checks else "-", f"≤ {number(most)}", lead <= most)
        + ("" if "lead" in checks and is_outdone(checks) else "its lead is small, or its form is wrong",),
    )
    out, asked = [], True
    if v.answer == "NOT_REPEATABLE":
        question = "Do records of one experiment agree better with each other than with the model?"
        out, asked = [Gate("replicates", question, "no", "yes", "failed")], False
    for name, question, value, needed, holds, because in rows:
        state = "passed" if holds else f"{UNMET} because {because}" if because else "failed"
        out.append(Gate(name, question, value if asked else "-", needed, state if asked else "not asked"))
        asked = asked and bool(holds or because)
    return out
