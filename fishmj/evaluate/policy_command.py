"""Card of a policy: its training, conditions in which it holds station, its worst trial; export as ONNX."""

import shlex
from collections import Counter
from typing import Any

from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.store import read_json
from fishmj.control.policy import SHIPPED, Policy, shipped
from fishmj.control.policy_meta import effects_drawn
from fishmj.evaluate.policy_card import PolicyCard, WaterJudgement, card_path, curve_beside, make_card, read_card, write_card
from fishmj.mjcf.reading import load_robot

EXAMPLES = """examples:
  fishmj policy                                    the shipped policies, side by side
  fishmj policy station                            its card
  fishmj policy station --onnx station.onnx        its network as ONNX (extra onnx); C: fishmj deploy firmware-policy
  fishmj evaluate runs/a --out runs/a/paper        a card for your own policy: judge it in some waters,
  fishmj policy runs/a --judged runs/a/paper       then write runs/a/best.card.json"""


def main(argv: list[str]) -> int:
    """Runs the verb `policy`; returns the exit code."""
    parser = console.parser("policy", __doc__ or "", examples=EXAMPLES)
    what = f"shipped policy ({', '.join(shipped())}), policy file, or folder of a training; by default a table of those shipped"
    parser.add_argument("policy", type=console.text, nargs="?", metavar="NAME", help=what)
    judged = "make the card from these folders of `fishmj evaluate --out`, and write it beside the policy; default: read it there"
    parser.add_argument("--judged", type=console.path, nargs="+", metavar="DIR", help=judged)
    rows = "with --judged: training curve of the card; default that in the training's folder"
    parser.add_argument("--curve", type=console.path, metavar="FILE", help=f"{rows}, metrics.jsonl")
    onnx = "write the network as ONNX, after its check against NumPy to 1e-6; default none"
    parser.add_argument("--onnx", type=console.out_file, metavar="FILE", help=onnx)
    args = parser.parse_args(argv)
    if args.policy is None:
        if args.judged or args.curve or args.onnx:
            raise ConfigError("policy: --judged, --curve and --onnx need a policy; name it")
        return listed(args.json)
    if args.curve and not args.judged:
        raise ConfigError("policy: --curve needs --judged; add it, or leave --curve out")
    answer: dict[str, Any] = {}
    if args.judged:
        curve = args.curve or curve_beside(args.policy)
        card = make_card(args.policy, [read_json(folder / "results.json") for folder in args.judged], curve)
        answer["card"] = write_card(card, card_path(args.policy))
    else:
        card = read_card(args.policy)
    console.say(*lines_of(card, Policy.load(args.policy), args.policy))
    if args.onnx:
        from fishmj.control.onnx_export import write_onnx

        answer |= {"onnx": args.onnx, "onnx_difference": (off := write_onnx(args.policy, args.onnx))}
        console.say("", f"wrote {args.onnx}: differs from NumPy by {off:.2g} at most")
    if "card" in answer:
        console.say("", f"wrote {answer['card']}")
    if args.json:
        console.emit_json(card.plain() | {"robot": Policy.load(args.policy).meta.get("robot")} | answer)
    return console.OK


def listed(as_json: bool) -> int:
    """Prints the shipped policies with their figures in each water; returns the exit code."""
    cards = {name: read_card(name) for name in shipped()}
    title = "trials that arrive, RMSE after arrival [m] with its 95 % interval; synthetic; waters in which several are judged"
    console.say(title, "", console.table(comparison(list(cards.values()))), "")
    console.say(*(f"{name}: {SHIPPED[name]}" for name in cards if name in SHIPPED), "", "fishmj policy NAME shows one in full")
    if as_json:
        console.emit_json({name: card.plain() for name, card in cards.items()})
    return console.OK


def comparison(cards: list[PolicyCard]) -> list[dict]:
    """Rows, one for each water in which several are judged, with a column for each policy."""
    rows: dict[str, dict] = {}
    for card in cards:
        for found in card.judged:
            row = rows.setdefault(found.where, {"water": found.where})
            row[card.policy] = f"{found.arrived} {found.overall['rmse_after_arrival'].text()}"
    common = {where: row for where, row in rows.items() if len(row) > 2 or len(cards) == 1}
    return [{"water": where, **{card.policy: row.get(card.policy) for card in cards}} for where, row in common.items()]


def lines_of(card: PolicyCard, policy: Policy, source: str) -> list[str]:
    """Card as text for people. source: the policy's name as the user gave it."""
    meta, get = policy.meta, card.training.get
    widths = "-".join(str(n) for n in (policy.weights[0][0].shape[1], *(w.shape[0] for w, _ in policy.weights)))
    sees = "the newest observation" if policy.memory == 1 else f"its last {policy.memory} observations and the actions between"
    lines = [
        f"policy {card.policy}, sha256 {card.sha256}, {card.origin}",
        f"network {widths} ({meta['activation']}), sees {sees}; trained for robot {meta.get('robot', 'not recorded')}",
        f"decides every {meta.get('control_dt', '?')} s on the command path {meta.get('command_path', 'not recorded')}",
        "",
        *(f"trained in {water}{f' ({n} times)' * (n > 1)}" for water, n in Counter(map(_water, card.waters or [{}])).items()),
        *([f"effects drawn: {', '.join(drawn)}"] if (drawn := effects_drawn(meta)) else []),
        f"command   {get('command', 'not recorded')}",
        f"seed      {get('seed', 'not recorded')}",
        f"cost      {_cost(card)}",
        *_curve(card),
        "",
    ]
    if not card.judged:
        name, robot = shlex.quote(source), "" if meta.get("robot") == load_robot("fish").name else " --robot FILE"
        text = f"judge it, `fishmj evaluate {name}{robot} --out DIR`, then `fishmj policy {name} --judged DIR`"
        return [*lines, f"where it holds: not judged; {text}"]
    radius = constant("protocol", "arrival_radius")
    lines += [f"where it holds (a trial holds if it arrives and stays within {radius:g} m RMS), 95 % intervals over trials"]
    lines += [console.table([_judged(found) for found in card.judged]), ""]
    for found in card.judged:
        worst = found.worst
        lines += [f"{found.where}: worst is {worst.trial}, {_metres(worst.rmse_after_arrival)}", f"  replay: {worst.replay}"]
        lines += [f"  judged by: {found.command}"]
    return lines


def _judged(judgement: WaterJudgement) -> dict:
    judged = judgement.held is not None
    lost = ", ".join(f"{u} m/s: {k} of {n}" if u else f"{k} of {n}" for u, (k, n) in judgement.lost().items())
    at = lambda u: f"{u}: {judgement.by_speed[u]['rmse_after_arrival'].text(interval=False)}"
    return {
        "water": judgement.where,
        "arrive": judgement.arrived,
        "hold": f"{judgement.held}/{judgement.n}" if judged else "-",
        "rmse after arrival [m]": judgement.overall["rmse_after_arrival"].text(),
        "last 20 s [m]": judgement.overall["rmse_last20"].text(interval=False),
        "worst [m]": "-" if (worst := judgement.worst.rmse_after_arrival) is None else f"{worst:.3f}",
        "rmse by speed [m/s: m]": ", ".join(map(at, judgement.speeds)),
        "do not hold": (lost or "none") if judged else "not judged",
    }


def _water(water: dict) -> str:
    if not water:
        return "a water that the header does not say"
    also = f", fitted to segments {water['segments'][:12]}" if "segments" in water else ""
    return f"{water['name']} ({water['kind']}, sha256 {water.get('sha256', 'not recorded')[:12]}{also})"


def _cost(card: PolicyCard) -> str:
    steps, seconds = card.training.get("steps"), card.training.get("seconds")
    counted = f"{steps / 1e6:.3g} million control steps" if steps else "control steps not recorded"
    took = f"{seconds:g} s" if seconds else "time not recorded"
    return f"{counted}, {took}, {card.training.get('machine', 'machine not recorded')}"


def _curve(card: PolicyCard) -> list[str]:
    if not card.curve:
        return ["curve     not kept"]
    rows = card.curve[:: max(1, len(card.curve) // 5)]
    rows += [] if rows[-1] is card.curve[-1] else [card.curve[-1]]
    names = {"step": "steps", "seconds": "s", "reward": "reward a step", "late_distance": "late distance [m]"}
    return ["curve", console.table([{title: row.get(key) for key, title in names.items()} for row in rows])]


def _metres(value: float | None) -> str:
    return "too short to judge" if value is None else f"{value:.3f} m"


if __name__ == "__main__":
    raise SystemExit(console.run(main))
