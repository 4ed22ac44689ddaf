"""What works on this machine, what will not, and the line that mends it.

Exit 1 if a core package is missing or at a version that fishmj does not run with.
"""

from fishmj import console
from fishmj.doctor import examine

MARKS = {"ok": "ok  ", "note": "note", "no": "no  ", "bad": "BAD "}


def options() -> console.Parser:
    """The arguments of `doctor`."""
    summary = "What works on this machine, what will not, and the line that mends it; exit 1 where a core package is not right."
    return console.parser("doctor", summary, examples="example:\n  fishmj doctor --json")


def main(argv: list[str]) -> int:
    args = options().parse_args(argv)
    findings = examine()
    section = ""
    for finding in findings:
        if finding.section != section:
            section = finding.section
            console.say("", section)
        console.say(f"  {MARKS[finding.state]} {finding.name:<24} {finding.text}")
    bad = [f.name for f in findings if f.state == "bad"]
    console.say("", f"to mend: {', '.join(bad)}" if bad else "all that fishmj needs is here")
    if args.json:
        console.emit_json({"healthy": not bad, "findings": [f._asdict() for f in findings]})
    return console.FAILED_CHECK if bad else console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
