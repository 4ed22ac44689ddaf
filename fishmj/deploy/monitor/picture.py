"""The monitor's statistics over time as a small SVG: one line a channel, 1 is an alarm.

Drawn by hand: the host has no Matplotlib.
"""

from collections.abc import Sequence
from html import escape

from fishmj.deploy.monitor.monitor import Alarm, History

WIDE, HIGH, LEFT, TOP, RIGHT, BELOW = 860, 300, 54, 30, 110, 44  # px
INK = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#8c564b", "#e377c2", "#17becf", "#bcbd22", "#7f7f7f")
MOST = 1.25  # of the limit, top of the picture
POINTS = 1200  # of a line


def drawn(title: str, history: History, alarms: Sequence[Alarm]) -> str:
    """The picture as SVG text."""
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
