"""Robots that tests simulate: small MJCF models as text, and a folder of the experiments."""

from pathlib import Path

import mujoco
from scipy.optimize import root

QUADRUPED = Path(__file__).resolve().parent.parent / "experiments" / "quadruped"

# Two hinges under gravity, with servos of their own.
PENDULUM = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.2" contype="0"
            conaffinity="0"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" armature="0.005"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.6" contype="0"
              conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder_servo" joint="shoulder" kp="80" kv="4"/>
    <position name="elbow_servo" joint="elbow" kp="30" kv="1"/>
  </actuator>
  <keyframe><key name="home" qpos="0.4 -0.7" ctrl="0.4 -0.7"/></keyframe>
</mujoco>
"""

# A box on the ground that carries a driven leg: a floating base with contacts.
HOPPER = """
<mujoco>
  <option timestep="0.002" cone="pyramidal"/>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1"/>
    <body name="box" pos="0 0 0.1">
      <freejoint/>
      <geom name="box" type="box" size="0.2 0.15 0.1" mass="8"/>
      <body name="arm" pos="0.1 0 0.1">
        <joint name="lift" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 0.3" size="0.02" mass="0.8" contype="0"
              conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="lift"/></actuator>
</mujoco>
"""

# A trunk that slides on a rail, held up by one driven leg whose foot stands on the ground.
MONOPED = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="trunk" pos="0 0 0.3">
      <joint name="rail" type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.05" mass="5" contype="0" conaffinity="0"/>
      <body name="leg">
        <joint name="hip" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 -0.28" size="0.01" mass="0.8" contype="0"
              conaffinity="0"/>
        <geom type="sphere" size="0.02" pos="0.1 0 -0.28" mass="0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hip"/></actuator>
</mujoco>
"""


def sagged(model, home, force, kp):
    """Where springs about `home` carry a model without contacts, with a force fed forward."""

    def missing(q):
        data = mujoco.MjData(model)
        data.qpos = q
        mujoco.mj_forward(model, data)
        return kp * (home - q) + force - data.qfrc_bias + data.qfrc_passive

    return root(missing, home, tol=1e-12).x
