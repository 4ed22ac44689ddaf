"""Collect what a water is fitted to: segments of the flow solver; the same as `hydro_fit collect`."""

from fishmj import console
from fishmj.campaign.command import main

if __name__ == "__main__":
    raise SystemExit(console.run(main))
