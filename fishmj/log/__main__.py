"""`python -m fishmj.log`: bring recordings in, check data sets, state what they hold.

python -m fishmj.log import FILES_OR_FOLDER... --out DATASET [--columns MAP.toml] [--robot NAME] [--yes]
python -m fishmj.log check DATASET
python -m fishmj.log manifest FOLDER
"""

import sys

from fishmj import console
from fishmj.log import bring, look

VERBS = (bring, look)  # modules with add(verbs), which registers their verbs and says which function each calls


def main(argv: list[str]) -> int:
    parser = console.parser("log", "Bring recordings in, and check data sets.", json=False)
    verbs = parser.add_subparsers(dest="verb", required=True)
    for module in VERBS:
        module.add(verbs)
    args, unknown = parser.parse_known_args(argv)
    if unknown:  # the verb's own parser knows which of its options is the nearest
        verbs.choices[args.verb].parse_args(argv[argv.index(args.verb) + 1 :])
    return args.call(args)


if __name__ == "__main__":
    sys.exit(console.run(main))
