"""Segments of the flow solver: what a water is fitted to (the same as `hydro_fit collect`), and logs with hidden effects.

python -m fishmj.campaign [--preview ...]        as `hydro_fit collect`
python -m fishmj.campaign hidden --sets 48 ...   data sets in which effects are hidden
"""

from fishmj import console


def main(argv: list[str]) -> int:
    if argv[:1] == ["hidden"]:
        from fishmj.campaign import hidden_command

        return hidden_command.main(argv[1:])
    from fishmj.campaign import command

    return command.main(argv)


if __name__ == "__main__":
    raise SystemExit(console.run(main))
