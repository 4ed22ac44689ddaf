"""`fishmj deploy firmware-policy`: exports a policy as the C header for the robot's firmware."""

from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import StoreError
from fishmj.base.store import sha256
from fishmj.control.policy import file_of
from fishmj.deploy.protocols.policy_header import write_header

EXAMPLES = """example:
  fishmj deploy firmware-policy station --out policy_constants.h"""


def main(argv: list[str]) -> int:
    """The command. Raises UnknownName, StoreError, ConfigError: no such policy, a damaged one, an existing file."""
    summary = "A policy as a C header, for a robot that computes it itself."
    parser = console.parser("deploy firmware-policy", summary, examples=EXAMPLES)
    parser.add_argument("policy", type=console.text, metavar="NAME", help="shipped policy, policy file, or folder of a training")
    parser.add_argument("--out", type=console.out_file, required=True, metavar="FILE", help="header to write")
    parser.add_argument("--force", action="store_true", help="replace a file that is there")
    args = parser.parse_args(argv)
    out = Path(args.out)
    if out.exists() and not args.force:
        raise StoreError(f"{out}: is there; name another file, or add --force")
    path = write_header(args.policy, out)
    digest = sha256(file_of(args.policy))
    console.say(f"{path}: policy {args.policy}, sha256 {digest[:12]}, {path.stat().st_size / 1e6:.2f} MB")
    if args.json:
        console.emit_json({"file": path, "policy_sha256": digest})
    return console.OK
