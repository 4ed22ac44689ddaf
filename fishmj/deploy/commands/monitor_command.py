"""`fishmj deploy monitor`: finds the time at which robot and model part, on logs."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import LogError
from fishmj.base.store import write_text
from fishmj.deploy.monitor.monitor import RATE, SETTLE, Alarm, History, Monitor, flow_of, has, reference_of, said
from fishmj.deploy.monitor.statistics import LEAST_BLOCKS
from fishmj.deploy.monitor.tick_interpolation import as_heard
from fishmj.log import Trial, read_trial
from fishmj.log.dataset import take
from fishmj.log.trial_folder import FLAT_FILE, META_FILE
from fishmj.log.unread_rows import joints
from fishmj.mjcf.identity import another_body
from fishmj.mjcf.reading import load_robot

WIDE, HIGH, LEFT, TOP, RIGHT, BELOW = 860, 300, 54, 30, 110, 44  # px, of the picture
INK = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#8c564b", "#e377c2", "#17becf", "#bcbd22", "#7f7f7f")
MOST = 1.25  # of the limit, top of the picture
POINTS = 1200  # of a line
EXAMPLES = """examples:
  fishmj deploy monitor runs/swim_07                             learns from the first 5 minutes, watches the rest
  fishmj deploy monitor runs/swim_07 --healthy runs/swim_01      against a healthy swim of the same robot
  fishmj deploy monitor runs/swim_07 --picture parted.svg --json"""


def options() -> console.Parser:
    """The arguments."""
    made = console.parser("deploy monitor", "Say when robot and model part, and in which channel.", examples=EXAMPLES)
    add = made.add_argument
    add("trials", nargs="+", type=console.path, metavar="TRIAL", help="trial folders, or data sets of them")
    learnt = "swims of the same robot to learn from (default: the first minutes of each)"
    add("--healthy", nargs="+", type=console.path, default=[], metavar="TRIAL", help=learnt)
    add("--robot", type=console.text, default="fish", help="the model: shipped name or TOML file (default fish)")
    add("--rate", type=console.number(1e-6, 60), default=RATE, help=f"false alarms an hour, all tests together (default {RATE})")
    settle = f"s of every trial to learn from, without --healthy (default {SETTLE:.0f})"
    add("--settle", type=console.number(1, 36000), default=SETTLE, help=settle)
    drawing = "SVG of the statistics over time; of several trials, one each with its name (default none)"
    add("--picture", type=console.out_file, help=drawing)
    return made


def main(argv: list[str]) -> int:
    """The command. Exit code 0: no alarm; 1: an alarm; 3: no trial is longer than the learning time."""
    args = options().parse_args(argv)
    robot = load_robot(args.robot)
    trials, healthy = opened(args.trials), opened(args.healthy)
    everything = list({**trials, **healthy}.values())
    for name, trial in {**trials, **healthy}.items():
        missing = [table for table in ("cmd", "joint") if not has([trial], table)]
        if missing:
            raise LogError(f"{name}: no table {', '.join(missing)}; the monitor compares commands with joint angles at least")
        for table, letter in (("cmd", "c"), ("joint", "j")):
            if (count := len(joints(trial.tables[table], letter))) != robot.n_joints:
                raise LogError(
                    f"{name}: table {table} has {count} joints, the model {robot.name!r} has {robot.n_joints}; name its own robot"
                    " with --robot"
                )
        whose = str(trial.value("robot") or robot.name)[:64]
        named = whose in (robot.name, args.robot)
        if not named or another_body(trial.meta, robot):
            body = " of another body" if named else ""
            console.warn(f"{name}: the log is of robot {whose!r}{body}, the model is {robot.name!r}; name its own with --robot")
    tables = {table: has(everything, table) for table in ("pose", "power")}
    for table, there in tables.items():
        if not there:
            console.warn(f"no table {table} in every trial: its channels are not watched")
    reference = reference_of(robot, healthy.values(), **tables) if healthy else None
    rows, pictures, watched = [], [], 0
    for name, trial in trials.items():
        late = trial.value("latency.pose")
        monitor = Monitor(robot, flow_of(trial), args.rate, args.settle, reference, camera=late, **tables)
        monitor.update(as_heard(trial.tables))
        watched += bool(monitor.history.t)
        seconds = monitor.history.t[-1] - monitor.history.t[0] if monitor.history.t else 0.0
        first = monitor.alarms[0] if monitor.alarms else None
        highest = (
            {c: max(share[c] for share in monitor.history.share) for c in monitor.blocks.probes} if monitor.history.t else {}
        )
        row = {"trial": name, "watched_s": round(seconds, 1), "alarms": len(monitor.alarms)}
        row |= {"first_s": first.t if first else None, "channel": first.channel if first else None}
        rows.append({**row, "probe": first.probe if first else None, "highest": highest})
        for alarm in monitor.alarms[:1]:
            console.say(f"{name}: {said(alarm)}")
        if args.picture and monitor.history.t:
            path = Path(args.picture)
            path = path if len(trials) == 1 else path.with_name(f"{path.stem}_{Path(name).name}{path.suffix}")
            write_text(path, drawn(name, monitor.history, monitor.alarms))
            pictures.append(str(path))
    console.say(console.table([{k: v for k, v in row.items() if k != "highest"} for row in rows]), *pictures)
    parted = [row["trial"] for row in rows if row["alarms"]]
    if parted:
        console.say(f"next: fishmj gap find {parted[0]}'s data set, with trials from before and after")
    if not watched:
        console.warn(
            f"nothing was watched: every trial is shorter than what is learnt from ({args.settle:.0f} s); give --healthy"
        )
    if args.json:
        console.emit_json({"rate": args.rate, "trials": rows, "pictures": pictures, "least_blocks": LEAST_BLOCKS})
    return console.FAILED_CHECK if parted else console.OK if watched else console.CANNOT_TELL


def opened(paths: list) -> dict[str, Trial]:
    """Trials by path: trial folders themselves, and every trial of a data set."""
    found: dict[str, Trial] = {}
    for path in map(Path, paths):
        if (path / META_FILE).is_file() or (path / FLAT_FILE).is_file():
            found[str(path)] = read_trial(path)
        else:
            found |= {str(path / name): trial for name, trial in take(path).trials.items()}
    return found


def drawn(title: str, history: History, alarms: Sequence[Alarm]) -> str:
    """Statistics over time as SVG text, one line a channel; 1 is an alarm. Drawn by hand: the host has no Matplotlib."""
    t = history.t
    begin, end = (t[0], max(t[-1], t[0] + 1.0)) if t else (0.0, 1.0)
    across = lambda s: LEFT + (WIDE - LEFT - RIGHT) * (s - begin) / (end - begin)
    up = lambda value: HIGH - BELOW - (HIGH - TOP - BELOW) * min(value, MOST) / MOST
    step = max(1, len(t) // POINTS)
    lines, names = [], list(history.share[0]) if history.share else []
    for k, name in enumerate(names):
        # the maximum of every stretch, so that a short peak is never thinned out
        peaks = [(t[i], max(share[name] for share in history.share[i : i + step])) for i in range(0, len(t), step)]
        points = " ".join(f"{across(s):.1f},{up(value):.1f}" for s, value in peaks)
        ink, y = INK[k % len(INK)], TOP + 16 + 16 * k
        lines.append(f'<polyline points="{points}" fill="none" stroke="{ink}" stroke-width="1.3"/>')
        lines.append(f'<text x="{WIDE - RIGHT + 12}" y="{y}" fill="{ink}">{escape(name)}</text>')
    for alarm in alarms:
        x = across(alarm.t)
        lines.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HIGH - BELOW}" stroke="#d62728" stroke-dasharray="4 3"/>')
        lines.append(f'<text x="{x + 3:.1f}" y="{TOP - 4}" fill="#d62728">{escape(alarm.channel)}</text>')
    ticks = [begin + (end - begin) * k / 5 for k in range(6)]
    axis = [f'<text x="{across(s):.1f}" y="{HIGH - BELOW + 16}" text-anchor="middle">{s:.0f}</text>' for s in ticks]
    axis += [f'<text x="{LEFT - 6}" y="{up(v) + 4:.1f}" text-anchor="end">{v:g}</text>' for v in (0.0, 0.5, 1.0)]
    bounds = f'x1="{LEFT}" x2="{WIDE - RIGHT}"'
    frame = [f'<line {bounds} y1="{up(v):.1f}" y2="{up(v):.1f}" stroke="{ink}"/>' for v, ink in ((0.0, "#444"), (1.0, "#d62728"))]
    head = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE} {HIGH}" font-family="sans-serif" font-size="12">',
        '<rect width="100%" height="100%" fill="#fff"/>',
        f'<text x="{LEFT}" y="14" font-weight="bold">{escape(title)}</text>',
        f'<text x="{(LEFT + WIDE - RIGHT) / 2}" y="{HIGH - 8}" text-anchor="middle">time, s</text>',
        f'<text x="14" y="{HIGH / 2}" transform="rotate(-90 14 {HIGH / 2})" text-anchor="middle">statistic / limit</text>',
    ]
    return "\n".join([*head, *frame, *axis, *lines, "</svg>"]) + "\n"
