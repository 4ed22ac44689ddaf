"""`python -m fishmj.log`: bring recordings in, check data sets, state what they hold, hand them to other programs.

python -m fishmj.log import FILES_OR_FOLDER... --out DATASET [--columns MAP.toml] [--robot NAME] [--yes]
python -m fishmj.log check DATASET
python -m fishmj.log manifest FOLDER
python -m fishmj.log export DATA_OR_TRIAL --to mcap|csv|parquet --out PATH
"""

import sys

from fishmj import console
from fishmj.log import bring, look
from fishmj.replay import export_command

VERBS = (bring, look, export_command)  # modules with add(verbs), which registers their verbs and says which function each calls


def main(argv: list[str]) -> int:
    parser = console.parser("log", "Bring recordings in, check data sets, hand them to other programs.", json=False)
    verbs = parser.add_subparsers(dest="verb", required=True)
    for module in VERBS:
        module.add(verbs)
    args, unknown = parser.parse_known_args(argv)
    if unknown:  # the verb's own parser knows which of its options is the nearest
        verbs.choices[args.verb].parse_args(argv[argv.index(args.verb) + 1 :])
    return args.call(args)


if __name__ == "__main__":
    sys.exit(console.run(main))
