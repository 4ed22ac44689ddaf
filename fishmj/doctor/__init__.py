"""The doctor: findings about machine, packages, devices and traps, and what follows from them."""

from fishmj.doctor import devices, known_issues, machine, packages
from fishmj.doctor.finding import Finding


def verdicts(findings: list[Finding]) -> list[Finding]:
    """What will and will not work, from the findings."""
    state = {(f.section, f.name): f.state for f in findings}
    core = all(f.state == "ok" for f in findings if f.section == "core")
    card = any(f.section == "devices" and f.name == "jax" and ("cuda" in f.text or "gpu" in f.text) for f in findings)

    def works(name: str, good: bool, text: str, otherwise: str) -> Finding:
        return Finding("works", name, "ok" if good else "no", text if good else otherwise)

    fast = state.get(("extras", "fast")) == "ok"
    return [
        works("train", core, "on the GPU" if card else "on the CPU", "mend the core packages first"),
        works("fast CPU engine", core and fast, "compiled", 'slower path: pip install "fishmj[fast]"'),
        works("evaluate, replay", core, "yes", "mend the core packages first"),
        works("--algo sb3-sac", core and state.get(("extras", "sb3")) == "ok", "yes", 'pip install "fishmj[sb3]"'),
        works(
            "replay looked at",
            state.get(("files", "browser")) == "ok",
            "headless browser",
            "no browser here; open the file elsewhere",
        ),
    ]


def examine() -> list[Finding]:
    """All findings, in the order of the report."""
    findings = [*machine.findings(), *packages.findings(), *devices.findings(), *machine.surroundings(), *known_issues.findings()]
    return [*findings, *verdicts(findings)]
