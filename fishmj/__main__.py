"""`python -m fishmj VERB ...`"""

from fishmj.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
