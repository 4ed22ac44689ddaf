"""The page of a search for a robot in MJCF: the sections of a fish's page that hold for any model, and the place by joint."""

from pathlib import Path

from fishmj.base.figures import style
from fishmj.base.pages import Section, part, table
from fishmj.base.store import sha256, write_text
from fishmj.gap.localise.robot_localisation import MOTIONS, RobotLocalisation
from fishmj.gap.report import sections
from fishmj.gap.report.pictures import STYLE
from fishmj.gap.report.report_data import ReportData, gather
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import percent, quantity, title
from fishmj.gap.workflow import Inquiry
from fishmj.mjcf.identity import robot_line_of

SET_ON = "Some thresholds were chosen on the logs of one robot. Benchmark of the answers: docs/search/mujoco_robot.md."


def write_robot_page(inquiry: Inquiry, place: RobotLocalisation, answers: dict[str, str], folder: Path) -> str:
    """Writes report.html; returns its name. answers: by effect."""
    m, path = gather(inquiry, place), inquiry.evidence.model.robot.path
    with style(STYLE):
        shown = [sections.gap(m), _where(place), _torques(m), _each(answers, inquiry.verdict), sections.candidates(m)]
        shown += [sections.checks(m, SET_ON), sections.invisible(m), sections.records(m)]
    line = robot_line_of(path.stem, str(path), sha256(path))
    write_text(folder / "report.html", sections.page_of(m, shown, line, next_step(inquiry), "logs", "verdict.json"))
    return "report.html"


def next_step(inquiry: Inquiry) -> str:
    """One sentence on the next step: for CLASS, what separates the effects."""
    v = inquiry.verdict
    if v.answer == "NAMED":
        return "Write it into the description with `fishmj gap apply`, then record new logs."
    known = {x.name: x for x in inquiry.evidence.model.active.effects}
    for r in v.rivals if v.answer == "CLASS" else ():
        one, other = str(r.get("instead_of", "")), str(r["name"])
        for a, b in ((one, other), (other, one)):
            for c in known[a].confusions if a in known else ():
                if c.other == b:
                    return f"{title(a)} or {title(b)}: {c.separates}."
    if v.implausible:
        names = " and ".join(title(e.name) for e in v.effects)
        return f"Check the numbers of the description that {names} would change: another record would show the same."
    if v.answer == "CLASS":
        return "Record a motion in which the listed effects differ: `fishmj gap next REPORT --out experiment.csv` writes one."
    if v.answer == "UNEXPLAINED":
        return "Inspect the joint and the motion with the largest residual, and the unexplained torques there."
    return "Nothing to add." if v.answer == "AGREES" else "Record more replicates."


def _where(place: RobotLocalisation) -> Section:
    rows = [
        {"joint": part("strong", title(joint)), "share": percent(share)} | {m: percent(place.motions[joint][m]) for m in MOTIONS}
        for joint, share in place.joints.items()
    ]
    times = [{"time": name, "share": percent(share)} for name, share in place.thirds.items()]
    about = "Shares of the present model's residual above the floor, by joint, joint speed and time in the log."
    return Section("Where it is", about, [part("beside", table(rows), table(times), "two")])


def _torques(m: ReportData) -> Section:
    """Section on unexplained torques; empty if they were not estimated."""
    found = m.inquiry.verdict.gates.get("torques", {})
    robot = m.inquiry.evidence.model
    unit = robot.robot.force_unit
    usual = dict(zip(robot.robot.channels, robot.sizes.torque.tolist(), strict=True))
    rows = [
        {"joint": part("strong", title(joint)), "before": quantity(a, unit(joint)), "after": quantity(b, unit(joint))}
        | {"usual torque of the joint": quantity(usual[joint], unit(joint))}
        for joint, (a, b) in found.items()
    ]
    about = "Most likely unexplained torque at each joint, in steps of 60 ms, before and after the found effects."
    return Section("Torques that the model does not explain", about, [table(rows) if rows else ""])


def _each(answers: dict[str, str], v: Verdict) -> Section:
    same = {e.name: "; ".join(e.equals()) for e in v.effects}
    rows = [
        {"effect": part("strong", title(name)), "answer": part("tag", answer)}
        | ({"the same on this robot in any motion": same[name]} if any(same.values()) else {})
        for name, answer in answers.items()
    ]
    return Section("Effect by effect", "One effect may be certain and another not.", [table(rows) if rows else ""])
