"""The page, from top to bottom: the answer first, then what it stands on."""

import re

import numpy as np

from fishmj import __version__
from fishmj.gap.localise.narrative import nothing
from fishmj.gap.report import pictures
from fishmj.gap.report.report_data import ReportData, Round, parted
from fishmj.gap.report.style import ANSWERS, SHEET
from fishmj.gap.report.svg import style
from fishmj.gap.report.traces import traces
from fishmj.gap.report.words import CONTRACT, LETTERS, gates, headline, meaning, next_step
from fishmj.gap.verdict import LIKELIHOOD, said
from fishmj.gap.wording import level, number, percent, quantity, sizes, title
from fishmj.pages import document
from fishmj.pages import escaped as escape


def html(m: ReportData) -> str:
    """Everything in one text."""
    v = m.inquiry.verdict
    with style():
        parts = [
            answer(m),
            "<main>",
            gap(m),
            where(m),
            seen(m),
            growth(m),
            candidates(m),
            forces(m),
            checks(m),
            invisible(m),
            records(m),
        ]
    tone = f"{SHEET}:root{{--tone:{ANSWERS[v.answer]}}}"
    body = "\n".join(part for part in parts if part)
    return document(headline(v), f"{body}\n{footer(m)}</main>", tone)


def answer(m: ReportData) -> str:
    """The answer, its value, what it means, what to do next, the figures that carry it."""
    v = m.inquiry.verdict
    value = ""
    if v.effects:
        tentative = v.answer == "UNEXPLAINED"
        shown = " · ".join(escape(sizes(n.name, n.parameters, len(v.effects) == 1 and not tentative)) for n in v.effects)
        shown = f"tentative: {shown}" if tentative else f'{shown} <span class="small">90&nbsp;% interval</span>'
        value = f'<p class="{"small" if tentative else "value"}">{shown}</p>'
    chips = "".join(
        f'<div class="{"on" if name == v.answer else ""}"><b>{name}</b>{escape(text)}</div>' for name, text in CONTRACT.items()
    )
    origin = "<span> synthetic data</span>" if m.inquiry.synthetic else ""
    return (
        f'<header><div><span class="mark">{v.answer}</span>{origin}<h1>{escape(headline(v))}</h1>{value}'
        f'<p class="lead">{told(meaning(m))}</p><p class="next"><b>Next</b>{told(next_step(m))}</p>'
        f'<div class="figures">{"".join(figures(m))}</div><div class="contract">{chips}</div></div></header>'
    )


def figures(m: ReportData) -> list[str]:
    """The few numbers that one asks for first."""
    v, last = m.inquiry.verdict, m.parts[-1]
    out = []
    if m.comparison.changed:
        out.append((f"{level(last.before)} → {level(last.after)}", f"gap on records {last.name}; 1 is agreement"))
        if v.shrinks and last.after < last.before:
            out.append((f"{percent(v.explained)}", f"of {LIKELIHOOD} is explained, on records not fitted to"))
    else:
        out.append((level(last.before), f"gap on records {last.name}; 1 is agreement"))
    if v.answer in ("NAMED", "CLASS") and v.effects:
        out.append((f"{min(e.p_best for e in v.effects):.2f}", "P(best): how surely the best of the catalogue"))
    seconds, effects = sum(r.seconds for r in m.inquiry.records), len(m.inquiry.evidence.plant.active.effects)
    out.append((f"{len(m.inquiry.records)}", f"records, {seconds:.0f} s; {effects} effects in question"))
    return [f"<div><b>{escape(a)}</b><span>{escape(b)}</span></div>" for a, b in out]


def gap(m: ReportData) -> str:
    """Before and after."""
    channels = list(dict.fromkeys(k for p in m.parts for k in (p.by_channel or {})))
    pair = lambda both: f"{level(both[0])} → {level(both[1])}" if m.comparison.changed else level(both[0])
    heads = "".join(f'<th class="n">{escape(p.name)}</th>' for p in m.parts)
    whole = "".join(f'<td class="n"><b>{pair((p.before, p.after))}</b></td>' for p in m.parts)
    rows = [f'<tr><td class="name">all</td>{whole}</tr>']
    for k in channels:
        both = [(p.by_channel or {}).get(k) for p in m.parts]
        cells = "".join(f'<td class="n">{pair(b) if b else "-"}</td>' for b in both)
        rows.append(f"<tr><td>{escape(k)}</td>{cells}</tr>")
    table = f"<table><thead><tr><th>gap</th>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    about = "Mean square of measured minus model in units of the floor; every channel and record counts alike, 1 is agreement. "
    about += "The floor is what an independent simulation of this very fish leaves, with nothing hidden in it. "
    if m.comparison.changed:
        about += "Square: the model as it was. Circle: with what was found, fitted without the records held out. "
    about += "Grey: where nine of ten null runs lie."
    drawn = pictures.gaps(m.parts, m.comparison.changed)
    inside = f'<div class="two"><figure>{drawn}</figure><div>{table}</div></div>{warnings(m)}'
    return section("The gap" + (", before and after" if m.comparison.changed else ""), about, inside)


def warnings(m: ReportData) -> str:
    """Why to be careful, before anything else is read."""
    notes, quiet = list(m.inquiry.verdict.warnings), ""
    for n in m.inquiry.verdict.tentative if m.inquiry.verdict.taken else ():
        notes.append(f"{title(n.name)} helped a little too, but could be something else: it is counted in, not named")
    if m.comparison.changed and not m.inquiry.verdict.shrinks:
        notes.append(f"What was found {m.inquiry.verdict.told()}")
    if not m.inquiry.unseen.any():
        quiet = "No record was kept apart: of nine or more a quarter is, for a last figure that no decision saw."
    about = "".join(f'<p class="about">{escape(n)}</p>' for n in m.inquiry.notes)  # file names: nothing of them is marked up
    return (
        "".join(f'<p class="warn">{told(n.rstrip("."))}.</p>' for n in notes)
        + about
        + (f'<p class="about">{quiet}</p>' if quiet else "")
    )


def where(m: ReportData) -> str:
    """Localisation."""
    p = m.place
    text = " ".join(filter(None, (p.text, m.weighed)))
    if nothing(p):
        return section("Where it is", "", f'<p class="place">{told(text)}</p>')
    drawn = f"<figure>{pictures.heat(p)}</figure>"
    detail = pictures.details(p, m.comparison.changed)
    about = "What the residual of the model looks like, before anything is named."
    keys = (
        '<p class="about">Each cell: its share of the gap beyond the floor, and its mean square. Every half second counts once.'
        " Grey in the left panel: lags within which a servo's tolerance lies.</p>"
    )
    more = f"<figure>{detail}</figure>" if detail else ""
    return section("Where it is", about, f'<p class="place">{told(text)}</p>{drawn}{more}{keys}')


def seen(m: ReportData) -> str:
    """Traces."""
    use = [part for part, unseen in zip(parted(m.inquiry), m.inquiry.unseen, strict=True) if not unseen]
    about = "The records in which most of the gap lies, one for each channel. The model runs free from the measured start."
    return section("The records that tell most", about, f"<figure>{traces(m.comparison, use)}</figure>")


def growth(m: ReportData) -> str:
    """Growth curves."""
    if not m.growth:
        return ""
    about = (
        f"The model is restarted from what was measured, {m.growth[0].restarts} times, and left alone for up to three seconds."
        " A slope of 0 is there at once (a sensor, a delay, an actuator), 1 grows like a velocity (current), 2 like a force"
        " (drag, thrust). Grey: what the uncertainty of the start can make by itself."
    )
    return section("How it grows", about, f"<figure>{pictures.growth(m.growth, m.comparison.changed)}</figure>")


def candidates(m: ReportData) -> str:
    """Ranked tables and confusion maps."""
    v = m.inquiry.verdict
    if not m.rounds:
        return ""
    about = (
        "The finalists, fitted to all records that decide, the largest P(best) first: the share of bootstrap draws over records"
        " that an effect wins, all seen in the evidence around the one that was tried. Behind: how much less likely than that one"
        " it makes the records, each in the evidence around itself, as a share of what that one gains; below zero, likelier."
        " Values are those of the round; what the head of the page says was fitted once more, with all that was taken."
        " The map is the cosine between what two of them change, seen through the floor: near 1 these records can hardly tell"
        " them apart."
    )
    blocks = [ranked(r, i, len(m.rounds)) for i, r in enumerate(m.rounds)]
    return section("What came closest" if v.answer == "AGREES" else "What it could be", about, "".join(blocks) + rounds(m))


def forces(m: ReportData) -> str:
    """What the gap looks like as a force, where no effect explains it."""
    if not m.inquiry.verdict.terms:
        return ""
    rows = []
    for t in m.inquiry.verdict.terms:
        mark = "firm" if t["firm"] else "weak"
        tag = f'<span class="tag {"passed" if t["firm"] else "not"}">{mark}</span>'
        alike = f'<br><span class="small">or {escape(", ".join(t["alike"][:3]))}</span>' if t["alike"] else ""
        size = f"{number(t['coefficient'])} {escape(t['unit'])}"
        name = f"<td><b>{escape(t['name'])}</b>{alike}</td>"
        numbers = (
            f'<td class="n">{size}</td><td class="n">{percent(t["closure"])}</td><td class="n">{percent(t["stability"])}</td>'
        )
        rows.append(f"<tr>{name}{numbers}<td>{tag}</td></tr>")
    heads = (
        '<tr><th>term</th><th class="n">coefficient</th><th class="n">takes off</th><th class="n">chosen in</th><th></th></tr>'
    )
    about = (
        "Forces and torques written as products of what the robot does, the largest gain on records not seen first: a description"
        " of what is missing, not a name. Takes off: share of the excess of |z|² over chance, against the floor of null runs, on"
        " the records that it was fitted to. Chosen in: share of half-samples of the records in which a term is among the first"
        " two. Firm: it passes every doubt."
    )
    return section("As a force", about, f"<table><thead>{heads}</thead><tbody>{''.join(rows)}</tbody></table>")


def ranked(r: Round, place: int, count: int) -> str:
    """One round."""
    rows = []
    for letter, row in zip(LETTERS, r.table, strict=False):
        values = "<br>".join(f"{escape(title(k))} {nobreak(quantity(*x))}" for k, x in row.values.items())
        share = '<span class="small">on a bound: no rival</span>' if row.p_best is None else _bar(row.p_best)
        mark = ' <span class="tag failed">rival</span>' if row.rival else ""
        behind = "tried" if row.tried else "-" if row.behind is None else f"{number(100 * row.behind)} %"
        name = f'<td class="name"><span class="letter">{letter}</span>{escape(title(row.name))}{mark}</td>'
        rows.append(f'<tr>{name}<td>{values}</td><td class="keep">{share}</td><td class="n">{behind}</td></tr>')
    heads = '<tr><th>effect</th><th>in its round</th><th>P(best)</th><th class="n">behind</th></tr>'
    head = f"<h3>Effect {place + 1}</h3>" if count > 1 else ""
    table = f"<table><thead>{heads}</thead><tbody>{''.join(rows)}</tbody></table>"
    drawn = f"<figure>{pictures.confusion(r)}</figure>" if len(r.table) > 1 else ""
    return f'{head}<div class="rank"><div>{table}</div><div>{drawn}</div></div>'


def rounds(m: ReportData) -> str:
    """What each round did."""
    items = "".join(
        f"<li>{escape(title('+'.join(s.ranked[0].names)))}: {said(s.accepted, s.gain, s.gap)}</li>" for s in m.inquiry.found.steps
    )
    return f'<p><b>Rounds</b></p><ul class="plain">{items}</ul>'


def _bar(share: float) -> str:
    return f'<span class="bar"><i style="width:{100 * share:.0f}%"></i></span>{share:.2f}'


def checks(m: ReportData) -> str:
    """Gates."""
    rows = "".join(
        f'<tr><td class="name">{g.name}</td><td>{escape(g.question)}</td><td class="n">{escape(g.value)}</td>'
        f'<td class="n">{escape(g.needed)}</td><td><span class="tag {g.state.split()[0]}">{g.state}</span></td></tr>'
        for g in gates(m)
    )
    heads = '<tr><th>gate</th><th>question</th><th class="n">found</th><th class="n">needed</th><th></th></tr>'
    about = "Thresholds were set on null runs and planted effects; benchmarks are scored on others."
    return section("Why this answer", about, f"<table><thead>{heads}</thead><tbody>{rows}</tbody></table>")


def invisible(m: ReportData) -> str:
    """What these records could not have shown."""
    if not m.blind:
        return ""
    items = "".join(f"<li>{escape(title(b.name))} <span class='small'>{escape(b.typical)}</span></li>" for b in m.blind)
    about = (
        "At their typical size these would change the records less than a name needs: nothing is said about them. Other"
        " experiments may show them (fishmj gap next)."
    )
    return section("What these records cannot show", about, f'<ul class="plain columns">{items}</ul>')


def records(m: ReportData) -> str:
    """What went in."""
    use = dict(zip([r.name for r in m.inquiry.records], parted(m.inquiry), strict=True))
    ratio = m.comparison.ratio
    rows = []
    for i, r in enumerate(m.comparison.records):
        some = m.comparison.layout.record == i
        before, after = (float(np.mean(x[some])) for x in ratio)
        pair = f"{level(before)} → {level(after)}" if m.comparison.changed else level(before)
        rows.append((r, pair))
    rows += [(r, "-") for r, u in zip(m.inquiry.records, m.inquiry.unseen, strict=True) if u]
    body = "".join(
        f'<tr><td class="name">{escape(r.name)}</td><td>{escape(r.excitation)}</td><td class="n">{r.seconds:.1f} s</td>'
        f'<td>{use[r.name]}</td><td class="n">{pair}</td></tr>'
        for r, pair in rows
    )
    heads = (
        '<tr><th>record</th><th>experiment</th><th class="n">length</th><th>use</th><th class="n">mean square, × floor</th></tr>'
    )
    return section("The records", "", f"<table><thead>{heads}</thead><tbody>{body}</tbody></table>")


def told(text: str) -> str:
    """Escaped, `code` as code, and no unit at the start of a line."""
    text = re.sub(r"(\d)%", r"\1 %", text)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))
    return re.sub(r"(\d) (%|ms|s|deg|mm|W)\b", "\\1\u00a0\\2", text).replace(" %", "\u00a0%")


def nobreak(text: str) -> str:
    """Escaped, on one line."""
    return escape(text).replace(" ", "\u00a0")


def section(name: str, about: str, inside: str) -> str:
    """One part of the page."""
    line = f'<p class="about">{escape(about)}</p>' if about else ""
    return f"<section><h2>{escape(name)}</h2>{line}{inside}</section>"


def footer(m: ReportData) -> str:
    """How it was made."""
    e = m.inquiry.evidence
    count = e.runs
    return (
        f"<footer>fishmj {__version__} · gap find · {len(e.records)} records in the search, {count} null runs of each ·"
        " the same figures as JSON: report.json</footer>"
    )
