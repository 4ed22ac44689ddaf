"""Forces of the water on a MuJoCo model of your own: a flapper of two links, whose angles are functions of time.

    python examples/own_mjcf.py

The model's geoms are its surface. Its frame is that of the box: (0, 0, 0) is the low corner. Replace the text by your model, or
by `mujoco.MjModel.from_xml_path("FILE.xml")`. Without `motion` it is free, without joints held. Everything is synthetic.
"""

import mujoco
import numpy as np

from fishmj.lbm_oracle import Scene

MODEL = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="front" pos="0.06 0.06 0.04">
      <joint name="neck" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 0.03 0 0" size="0.012" contype="0" conaffinity="0"/>
      <body name="rear" pos="0.045 0 0">
        <joint name="tail" axis="0 0 1"/>
        <geom type="ellipsoid" pos="0.025 0 0" size="0.025 0.009 0.016" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
SPEED, PERIOD, SWING = 0.02, 2.0, np.radians([10.0, 25.0])  # m/s, s, rad


def angles(t: float) -> np.ndarray:
    """Angles (2,) of neck and tail, rad, at time t in s: the tail follows by a quarter of a period."""
    return SWING * np.sin(2 * np.pi * t / PERIOD - np.array([0.0, np.pi / 2]))


scene = Scene(box=(0.2, 0.12, 0.08), dx=0.002, nu=2e-6, stream=SPEED, dt=0.002)
scene.add(mujoco.MjModel.from_xml_string(MODEL), motion=angles)
times, wrench = scene.run(PERIOD, every=10)
print(scene)
for name, force in zip(("front", "rear"), np.moveaxis(wrench[..., :3], 1, 0), strict=True):
    mean, greatest = force.mean(0), np.abs(force).max(0)
    print(f"{name:<6} mean drag {1e3 * mean[0]:6.3f} mN, greatest side force {1e3 * greatest[1]:6.3f} mN")
scene.plot("own_mjcf.png")
assert np.isfinite(wrench).all() and len(times) == 100
