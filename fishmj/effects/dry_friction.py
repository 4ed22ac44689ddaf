"""Dry friction that sticks, shared by the effects of gear trains.

    z <- clip(z + h w, +-b)              deflection of the teeth before they slide
    s = (z + h w - z) / h                sliding speed; zero while the teeth only deflect
    tau = -F(s)/b (z~ + h w'),           z~ = clip(z + h w, +-b) - h w, w' the rate after the step: at most F, and too little
                                         to reverse the motion
    tau = -F(s) w'/|w~|                  if a step moves further than b; w~ the larger of w and w + (w - w_before), the
                                         expected w' while a joint breaks away

A joint at rest stays there until the motor overcomes F. A friction that grows with speed near rest would instead let a loaded
joint creep back within seconds. (Jenkins' slider; presliding of Dahl 1968, DOI 10.21236/ADA041920.)
"""

GIVE = 0.001  # rad, b, a quarter of a servo's encoder count
AT_REST = (0.0, 0.0)  # z rad, w rad/s of the step before


def apply_dry_friction(xp, friction, g, memory, h: float):
    """(Gear, memory) of one joint; friction(s) is the largest friction torque [N m] at a sliding speed s [rad/s]."""
    clip = lambda way: xp.minimum(xp.maximum(way, -GIVE), GIVE)
    z, before = memory
    way = z + h * g.rate
    z = clip(way)
    most = friction((way - z) / h)
    ahead = 2.0 * g.rate - before
    far = h * xp.maximum(xp.abs(g.rate), xp.where(ahead * g.rate > 0.0, xp.abs(ahead), 0.0))
    spring = xp.where(far > GIVE, 0.0, clip(z + h * g.rate) - h * g.rate) / GIVE
    g = g._replace(torque=g.torque - most * spring, resist=g.resist + most * h / xp.maximum(far, GIVE))
    return g, (z, g.rate)
