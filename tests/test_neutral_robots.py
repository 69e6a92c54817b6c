"""Robots whose joints no stiffness holds, as wheels under velocity servos: nothing grows."""

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx

WHEEL = """<body pos="{x} {y} 0"><joint name="{name}" axis="0 1 0"/>
  <geom type="cylinder" size=".1 .03" euler="90 0 0" mass=".5"/></body>"""
CART = f"""<mujoco><option timestep=".001"/><worldbody><geom type="plane" size="9 9 .1"/>
  <body pos="0 0 .1"><freejoint/><geom type="box" size=".3 .2 .05" mass="8"/>
  {"".join(WHEEL.format(x=x, y=y, name=f"wheel{x}{y}") for x in (-0.2, 0.2) for y in (-0.3, 0.3))}
  <body pos="0 0 .1"><joint name="arm" axis="0 1 0"/>
  <geom type="capsule" size=".03" fromto="0 0 0 0 0 .3" mass="1"/></body></body></worldbody>
  <actuator><velocity joint="wheel-0.2-0.3" kv="1"/><velocity joint="wheel-0.20.3" kv="1"/>
  <velocity joint="wheel0.2-0.3" kv="1"/><velocity joint="wheel0.20.3" kv="1"/>
  <position joint="arm" kp="40" kv="2"/></actuator></mujoco>"""
ARM = """<mujoco><option timestep=".001" gravity="0 0 0"/><worldbody>
  <body><joint name="a" axis="0 1 0"/>
  <geom type="capsule" size=".04" fromto="0 0 0 .4 0 0" mass="2"/>
  <body pos=".4 0 0"><joint name="b" axis="0 1 0"/>
  <geom type="capsule" size=".03" fromto="0 0 0 .3 0 .05" mass="1"/></body></body></worldbody>
  <actuator><velocity joint="a" kv="2"/><velocity joint="b" kv=".4"/></actuator></mujoco>"""


def robot(folder, text, **options):
    path = folder / "robot.xml"
    path.write_text(text)
    return jx.robot(path, **options)


@pytest.mark.exhaustive
@pytest.mark.parametrize("text", [ARM, CART], ids=["arm", "cart"])
def test_margins_and_simulations_agree_that_nothing_grows(tmp_path, text):
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    driven = [model.jnt_dofadr[joint] for joint in model.actuator_trnid[:, 0]]
    data.qvel[driven] = 0.1
    for _ in range(1500):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel[driven]).max() < 0.01

    given = robot(tmp_path, text)
    assert jx.margins(given).stable
    run = jx.simulate(given, duration=1, engine="mujoco")
    assert jx.Verdict(int(run.verdict)) == jx.Verdict.STABLE and run.growth_rate == 0.0
    maps = jx.sweep(given, gain_scale=[0.5, 1.0, 2.0], duration=0.5, engine="mujoco")
    np.testing.assert_array_equal(maps.verdict, 0)
    np.testing.assert_array_equal(maps.growth_rate, 0.0)


@pytest.mark.exhaustive
def test_too_much_gain_is_unstable_there_too(tmp_path):
    given = robot(tmp_path, ARM, delay=0.02, gain_scale=40.0)
    run = jx.simulate(given, duration=0.5, engine="mujoco")
    assert not jx.margins(given).stable and jx.Verdict(int(run.verdict)) == jx.Verdict.UNSTABLE


@pytest.mark.exhaustive
def test_the_one_joint_of_a_robot_has_the_delay_margin_of_all(tmp_path):
    """Controlled slowly, where the phase at its crossover in seconds is something else."""
    text = """<mujoco><option gravity="0 0 0"/><worldbody><body>
      <joint name="j" axis="0 1 0" armature=".0439"/><geom size=".001" mass="1e-6"/></body>
      </worldbody><actuator><motor joint="j"/></actuator></mujoco>"""
    found = jx.margins(
        robot(tmp_path, text, kp=1.39, kd=0.0933, wn=136.0, zeta=0.0433, control_rate=10)
    )
    own = {name: values.item() for name, values in found.of_joints.items()}
    assert own["delay_margin"] == found.delay_margin
    phase = own["phase_margin"] / own["gain_crossover"]
    assert abs(phase / own["delay_margin"] - 1.0) > 0.1
