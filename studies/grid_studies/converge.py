"""`fishmj lbm_oracle converge`: does the error of the fluid fall with the square of the cell? Exit 1 off order.

`fishmj lbm_oracle converge fish` is the study of the fish itself (`converge_fish`).
"""

from math import log2

from fishmj.base import console
from fishmj.lbm_oracle.cases.poiseuille import profile_error
from fishmj.lbm_oracle.cases.taylor_green import decay
from fishmj.lbm_oracle.fluid.device import device_of

ORDER, ROOM = 2.0, 0.2


def study(name: str, device: str) -> list[dict]:
    """Error and order from each size to the next."""
    sizes, error = {
        "taylor_green": ((16, 32, 64), lambda n: decay(n, device)[0]),
        "poiseuille": ((8, 16, 32), lambda n: profile_error(n, device)),
    }[name]
    rows, before = [], None
    for n in sizes:
        now = error(n)
        rows.append({"problem": name, "cells": n, "error": now, "order": log2(before / now) if before else None})
        before = now
    return rows


def main(argv: list[str]) -> int:
    """Runs the verb `converge`; returns its exit code, 1 if the order is off."""
    parser = console.parser(
        "lbm_oracle converge", "Order of convergence on closed solutions (`converge fish`: another study); exit 1 off order."
    )
    parser.add_argument("--device", type=console.device, default="cpu", help="cpu, cuda or auto")
    args = parser.parse_args(argv)
    device = str(device_of(args.device))
    table = [row for name in ("taylor_green", "poiseuille") for row in study(name, device)]
    orders = [row["order"] for row in table if row["order"] is not None]
    ok = all(order >= ORDER - ROOM for order in orders)
    console.say(console.table(table), f"expected order {ORDER:g}, at least {ORDER - ROOM:g}: {'ok' if ok else 'MISS'}")
    if args.json:
        console.emit_json({"converge": table, "ok": ok})
    return console.OK if ok else console.FAILED_CHECK
