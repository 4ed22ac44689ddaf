"""Which water of the flow solver a figure was made in: box and grid, slip ratio, immersed boundary.

`PLAIN` is what `--water lbm` means by itself, the paper's tank and grid, where the shipped fitted water and the published tables
come from. `REFERENCE` is the water for judging, asked for by name (`--water lbm --reference`); it stays so, another one gets
another `name`. Grid and slip ratio were chosen by what half the cell changes and by the swims of a real fish
(docs/results/flow_solver.md, "The reference water").

Another treatment of the boundary enters here: as a field with its default, that `immersed` hands on.
"""

from typing import Any, NamedTuple

from fishmj.errors import ConfigError
from fishmj.lbm_oracle.immersed import markers
from fishmj.lbm_oracle.immersed.markers import Sharpness
from fishmj.lbm_oracle.run.domain import Domain, preset


class SolverWater(NamedTuple):
    """Box of water by name for a tank, and for a fish that swims away; slip ratio of the hull at the paper's grid.

    width, passes, sharpness: of the immersed boundary (`SwimSetup`).
    """

    name: str
    domain: str
    window: str
    slip: float = 1.0
    width: int = 3
    passes: int = 2
    sharpness: Sharpness = markers.PLAIN

    @property
    def box(self) -> Domain:
        return preset(self.domain)

    @property
    def immersed(self) -> dict[str, Any]:
        """Options of the immersed boundary, of `SwimSetup`."""
        return {"width": self.width, "passes": self.passes, "sharpness": self.sharpness}

    @property
    def label(self) -> str:
        """For tables and file names: `paper, slip 1`; the reference by its name, too."""
        named = "" if self.name == PLAIN.name else f"{self.name}, "
        return f"{named}{self.domain}, slip {self.slip:g}"

    @property
    def said(self) -> str:
        """One line for people: cells far from the fish and at it."""
        cells = " and ".join(f"{1e3 * level.dx:g} mm" for level in self.box.levels)
        return f"{self.label}; cells of {cells}{', the last round the fish' if self.box.fine else ''}"


PLAIN = SolverWater("lbm", "paper", "window_coarse")
REFERENCE = SolverWater("reference-1", "paper_refined", "window_coarse_refined", slip=0.9)


def asked_for(who: str, reference: bool, domain: str | None, slip: float | None, plain: str | None = None) -> SolverWater:
    """The water that options ask for.

    Args:
        who: the verb, for the message. domain, slip: as given, None where they were not. plain: its box without either.

    Raises:
        ConfigError: the reference, and another box or slip ratio.
    """
    if not reference:
        return PLAIN._replace(domain=domain or plain or PLAIN.domain, slip=PLAIN.slip if slip is None else slip)
    if domain is not None or slip is not None:
        given = f"--domain {domain}" if domain is not None else f"--slip {slip:g}"
        raise ConfigError(f"{who}: {given} beside --reference, which is {REFERENCE.said}; leave one of them out")
    return REFERENCE
