"""What the prior coefficients of the strip water give. Synthetic: literature values, fitted to no flow.

python examples/gait_map.py [PICTURE]     swimming, turning, tow drag, added mass; the picture; 25 s of CPU
python examples/gait_map.py --steps       the speed against the physics step, 0.5 to 8 ms
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from fishmj import mjcf
from fishmj.water import planar_water
from fishmj.water.dynamics import planar_chain

CHAIN, FISH, DEG = planar_chain.chain_of(mjcf.load_robot("fish")), planar_chain.nominal(mjcf.load_robot("fish")), np.pi / 180
STILL = [(0.0, 0.0)] * CHAIN.n


def swim(hertz, degrees, lag, bias=0.0, dt=CHAIN.dt, seconds=40.0, tail=4.0):
    """Broadcast gaits [Hz, deg]: speed along the path [m/s], yaw rate [deg/s], servo power [W] over the last `tail` s."""
    hertz, degrees, lag, bias = np.broadcast_arrays(*(np.asarray(a, float) for a in (hertz, degrees, lag, bias)))
    rest, ch, rows = np.zeros(hertz.shape), CHAIN._replace(dt=dt), []
    q, v, attached = [rest] * 6, [rest] * 6, rest + 0.5
    for t in np.arange(round(seconds / dt)) * dt:
        wave = [bias + degrees * np.sin(2 * np.pi * hertz * t - j * lag * DEG) for j in range(3)]
        step = planar_chain.step(np, ch, FISH, q, v, attached, [min(t, 1.0) * DEG * w for w in wave], STILL, (0.0, 0.0))
        q, v, attached = step.q, step.v, step.attached
        rows.append([*q[:3], step.power])
    x, y, yaw, power = np.moveaxis(rows[-round(tail / dt) - 1 :], 1, 0)
    half, chord = (yaw[-1] - yaw[0]) / 2, np.hypot(x[-1] - x[0], y[-1] - y[0])
    return chord / np.sinc(half / np.pi) / tail, 2 * half / DEG / tail, power[1:].mean(0)  # an arc of 2 x half


if "--steps" in sys.argv:
    for dt in (0.0005, 0.001, 0.002, 0.004, 0.008):
        wave, phase = swim(1.0, 30, [60, 0], dt=dt, seconds=12.0)[0]
        print(f"step {dt * 1e3:3.1f} ms: lag 60 deg {wave:.4f} m/s, in phase {phase:.4f} m/s")
    sys.exit()
hertz, bias = np.arange(0.25, 2.01, 0.25), np.array([10.0, 20.0, 30.0])
(wave, phase), _, (watts, watts_phase) = swim(hertz, 30, [[60], [0]])
for row in list(zip(hertz, wave, watts, phase, watts_phase, strict=True))[1::2]:
    print("{:.1f} Hz, 30 deg: lag 60 deg {:.3f} m/s, {:.2f} W; in phase {:.3f} m/s, {:.2f} W".format(*row))
around, turn, _ = swim(1.0, 30, 60, bias)
for degrees, speed, rate in zip(bias, around, turn, strict=True):
    print(f"bias {degrees:.0f} deg, 1 Hz: {rate:.1f} deg/s at {speed:.3f} m/s, radius {speed / abs(rate * DEG):.2f} m")
towed = planar_chain.kinematics(np, CHAIN, [0.0] * 6, [0.3, 0.0, 0.0, 0.0, 0.0, 0.0], STILL)  # straight, 0.3 m/s ahead
drag = -sum(f[0] for f in planar_chain.water_forces(np, CHAIN, FISH, towed, 0.0, (0.0, 0.0), 0.5))
heave = [k * mu[0] for k, mu in zip(FISH.water.k, CHAIN.strips.mu, strict=True)]
own, added = (planar_chain.mass_matrix(CHAIN, FISH, towed, rigid=r, water=not r) for r in (True, False))
ratio = np.linalg.eigvals(np.linalg.solve(*(planar_water.world_matrix(CHAIN, 0.0, m) for m in (own, added)))).real
print(f"tow drag at 0.3 m/s: {drag:.3f} N; added mass sideways {sum(heave):.2f} kg, links {np.round(heave, 2).tolist()}")
print(f"added over own inertia, straight fish: {np.round(np.sort(ratio)[::-1], 2).tolist()}")
assert (np.diff(wave[:6]) > 0).all() and 0.1 < phase[3] < wave[3] < 0.5, "faster beats swim faster; a wave beats in phase"
assert (np.diff(np.abs(turn)) > 0).all() and (turn < 0).all(), "a bias to the left turns the fish to the right, more of it faster"
assert 0.05 < drag < 0.2 and 2.0 < sum(heave) < 2.4, "a slender body: little drag ahead, much water sideways"
figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
axes.legend(axes.plot(hertz, wave, "o-", hertz, phase, "s-"), ["lag 60 deg", "in phase"])
axes.set(xlabel="beat frequency [Hz]", ylabel="speed in still water [m/s]", title="30 deg on all joints (synthetic, prior)")
figure.savefig(sys.argv[1] if sys.argv[1:] else "docs/figures/gait_map.png", dpi=130)
