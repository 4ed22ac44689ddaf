"""Start values of a description before any measurement: water by shape, masses that float level.

Both come from the literature (docs/simulate/water.md has the sources and their ranges). They are fitted to no flow and to no
fish.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.mjcf.description import Link

K_BODY, K_PLATE = 0.9, 0.8  # added mass over rho pi/4 h^2
CN_BODY, CN_PLATE = 1.2, 2.0  # cross-flow drag
BODY, PLATE = 3.0, 13.0  # height over width of a section: a body up to the first, a plate from the second
CONSTANT = {  # of docs/simulate/water.md, "Prior coefficients"; the same for every shape
    "cf": 0.012,
    "ca_forward": 0.40,
    "ca_backward": 0.65,
    "ke": 0.3,
    "lift_a": 0.3,
    "lift_b": 0.7,
    "stall_angle_deg": 170.0,  # no stall, within the bounds of a fit
    "stall_width_deg": 6.0,
    "stall_lag": 3.0,
    "stations": 6,
}
BALLAST = 0.2  # depth of a link's centre of mass below its axis over its body's height, as the default fish has it
_POINTS = 400  # quadrature points along a link


def water_prior(links: Sequence[Link]) -> dict:
    """The `[water]` table of a fish with these links: `k` and `cn` by their shape, the rest constant.

    With the plate share p of a link, 0 for a body of round sections and 1 for a thin plate,

        k  = 0.9 - 0.1 p            cn = 1.2 + 0.8 p
        p  = integral h^2 g p(s) ds / integral h^2 g ds
        p(s) = 1 behind `fin_from`, else clip((h / w - 3) / (13 - 3), 0, 1)

    where g is the weight of a strip in the link's motion: s^2 for a link that turns about its front end, 1 for the head. A thin
    trailing plate thus makes a tail a plate, although its root is round.

    - k: 0.9 for the whole hull (Lamb's integral for the default fish as an ellipsoid gives 0.93 of the strips), 0.7 to 0.85 for a
      plate of finite span; cn: ellipses 1.1 to 1.3 (circular cylinder 1.20), steady plates 1.17 (square) to 1.98 (long), more
      when they flap, hence 2.0 for a plate. Sources and the parts that were read: docs/simulate/water.md.
    - ke and stall: a tail that moves more sideways than ahead meets the water at up to 90 deg. With a wing's stall its thrust
      dies away, where the flow solver's and a real fish go on accelerating. Without stall and with ke = 0.3, below the range of
      0.4 to 0.9, shapes swim about as fast as in the flow solver at the slip ratio of a real fish
      (`studies/NOTES_new_shapes.md`). The shipped descriptions have 0.5 and 35 deg, on which their results rest.
    - 3 and 13 are chosen; the literature read here does not give the drag of sections between. They give the
      default fish and the tendon fish the values in their descriptions: k rounded to 0.05, cn to 0.1, which is
      finer than the ranges above.

    Args:
        links: nose first; sections as described, before their widths are scaled to float.
    Returns:
        a table with the keys of `[water]` in data/calib/fish.toml; k and cn have one value a link.
    """
    share = [plate_share(link, turns=i > 0) for i, link in enumerate(links)]
    k = [round(20 * (K_BODY + p * (K_PLATE - K_BODY))) / 20 for p in share]
    cn = [round(CN_BODY + p * (CN_PLATE - CN_BODY), 1) for p in share]
    return {"k": k, "cn": cn, **CONSTANT}


def plate_share(link: Link, *, turns: bool = True) -> float:
    """Share of a link that acts as a plate in the water, 0 to 1; formula in `water_prior`. turns: about its front end."""
    s, h, w = _sections(link)
    flat = np.clip((h / np.maximum(w, 1e-9) - BODY) / (PLATE - BODY), 0.0, 1.0)
    if link.fin_from is not None:
        flat = np.where(s > link.fin_from, 1.0, flat)
    weight = h**2 * (s**2 if turns else 1.0)
    return float(weight @ flat / weight.sum())


def displaced(links: Sequence[Link], density_water: float = 1000.0) -> np.ndarray:
    """Mass of water (N,) kg that each link displaces with its sections as described: rho integral pi/4 h w ds."""
    parts = [_sections(link) for link in links]
    return np.array(
        [density_water * np.pi / 4 * np.mean(h * w) * link.length for link, (_, h, w) in zip(links, parts, strict=True)]
    )


def balanced(links: Sequence[Link], mass: float) -> tuple[Link, ...]:
    """The links with masses and centres of mass such that a fish of `mass` kg floats level, straight and bent.

    Every link weighs what it displaces, m_i = m V_i / sum V, and balances about its own centroid, so that no joint angle moves
    the centre of mass off the centre of buoyancy. Its centre of mass lies 0.2 body heights below the axis, which rights it; a
    link that is a plate from its front on carries no ballast. Masses are rounded to 1 mg and add up to `mass`.

    Raises ConfigError: the mass is not positive, or so small that a link is lost in rounding.
    """
    if not (np.isfinite(mass) and mass > 0):
        raise ConfigError(f"balanced: mass = {mass} kg; expected a positive mass of the whole fish")
    share = displaced(links)
    masses = np.round(mass * share / share.sum(), 6)
    masses[np.argmax(masses)] += mass - masses.sum()  # the largest link takes what rounding left
    if masses.min() <= 0:
        raise ConfigError(f"balanced: link {links[int(np.argmin(masses))].name} would weigh less than 1 mg of {mass} kg")
    made = []
    for link, part in zip(links, masses, strict=True):
        s, h, w = _sections(link)
        body = h if link.fin_from is None else h[s <= link.fin_from]
        depth = BALLAST * float(body.max()) if len(body) else 0.0
        centre = round(float((h * w) @ s / np.sum(h * w)), 6)
        made.append(replace(link, mass=round(float(part), 9), com=(centre, 0.0, 0.0 - round(depth, 4))))
    return tuple(made)


def _sections(link: Link) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Station, height and width (n,) at the midpoints of n equal pieces of a link, m."""
    rows = np.array(link.sections, float)
    s = (np.arange(_POINTS) + 0.5) / _POINTS * link.length
    return s, np.interp(s, rows[:, 0], rows[:, 1]), np.interp(s, rows[:, 0], rows[:, 2])
