"""`fishmj lbm_oracle cases`: the validation table, exit 1 on a miss."""

from fishmj import console
from fishmj.lbm_oracle import cases
from fishmj.lbm_oracle.fluid.device import device_of


def main(argv: list[str]) -> int:
    parser = console.parser("lbm_oracle cases", "Known answers, each beside its reference; exit 1 on a miss.")
    parser.add_argument("names", type=console.text, nargs="*", metavar="NAME", help="default: the quick ones")
    parser.add_argument("--all", action="store_true", help="every case; on the CPU without those marked gpu")
    parser.add_argument("--quick", action="store_true", help="those that fit three minutes on two cores (the default)")
    parser.add_argument("--list", action="store_true", help="name the cases and stop")
    parser.add_argument("--device", type=console.device, default="cpu", help="cpu, cuda or auto")
    args = parser.parse_args(argv)
    if args.list:
        return _list(args.json)
    cases.pick(args.names, quick=not args.all, everything=args.all, gpu=True)  # a wrong name fails before a device is looked for
    device = str(device_of(args.device))
    outcomes, table = [], []
    for case in cases.pick(args.names, quick=not args.all, everything=args.all, gpu=device.startswith("cuda")):
        done = cases.solve(case, device)
        outcomes.append(done)
        table += cases.rows(done)
        console.say(
            console.table(cases.rows(done)), f"{case.name}: {case.grid}, {console.duration(done.seconds)}; {case.source}", ""
        )
    missed = [row for row in table if row["verdict"] == "MISS"]
    total = sum(done.seconds for done in outcomes)
    gated = sum(row["verdict"] != "reported" for row in table)
    console.say(f"{gated - len(missed)} of {gated} checks hold, {console.duration(total)} on {device}")
    if args.json:
        seconds = {done.case.name: done.seconds for done in outcomes}
        console.emit_json({"cases": table, "seconds": seconds, "device": device, "ok": not missed})
    return console.FAILED_CHECK if missed else console.OK


def _list(as_json: bool) -> int:
    table = [
        {"rung": case.rung, "case": case.name, "quick": case.quick, "gpu": case.gpu, "grid": case.grid, "cost": case.cost}
        | {"what": case.summary}
        for case in cases.known().values()
    ]
    console.say(console.table(table))
    if as_json:
        console.emit_json({"cases": table})
    return console.OK
