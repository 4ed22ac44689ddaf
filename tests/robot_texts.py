"""MJCFs as authors write them, *synthetic*: comments, default classes, degrees, included files, unnamed parts."""

LEG = """<?xml version="1.0"?> <!-- A leg on a stand
     and its "servos" -- gains of 3 May. -->
<mujoco model="leg &amp; hip">
  <compiler angle="degree"/>
  <include file="classes.xml"/>   <!-- default classes -->
  <option timestep="0.002"/>  <!-- of the recording -->
  <worldbody>
    <frame pos="0 0 1">
      <body name="thigh" childclass="leg">  <!-- carbon -->
        <!-- 60 deg both ways -->
        <joint name='hip' axis="0 1 0" range='-60 60'/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03"/>
        <body name="shank" pos="0 0 -0.3">
          <inertial pos="0 0 -0.15000000000000002" mass="0.4"
                    fullinertia="0.003 0.0031 0.0004 0 1e-5 0"/>
          <joint name="knee" class="stiff"
                 axis="0 1 0"/>
        </body>
      </body>
    </frame>
  </worldbody>
  <actuator>
    <!-- one servo a joint -->
    <position name="hip" joint="hip" class="leg" kp="20"/>
    <velocity name="knee" joint="knee" kv="0.8" forcelimited="false"></velocity>
  </actuator>
</mujoco>
"""
CLASSES = """<mujocoinclude>
  <default>
    <default class="leg">
      <joint damping="0.05 0.01" frictionloss="0.02"/>
      <position dampratio="1" ctrlrange="-60 60"/>
      <default class="stiff">
        <joint stiffness="1.5" armature="0.002"/>
      </default>
    </default>
  </default>
</mujocoinclude>
"""


def write_leg(folder):
    """Writes the leg and its classes; returns the path of the leg."""
    (folder / "classes.xml").write_text(CLASSES)
    path = folder / "leg.xml"
    path.write_text(LEG)
    return path
