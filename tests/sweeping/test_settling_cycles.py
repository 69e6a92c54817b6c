"""Robots behind force limits that come down to their limit cycle from a larger motion."""

import numpy as np
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.status import Verdict

# Two links without dry friction, whose forces are limited.
ARM = """<mujoco><option timestep="0.0005"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" damping="0.1" armature="0.02"/>
<geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" mass="1.0"/><body pos="0.3 0 0">
<joint name="b" axis="0 1 0" damping="0.05" armature="0.01"/>
<geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" mass="0.7"/></body></body></worldbody>
<actuator><position joint="a" kp="60" kv="1.5" forcerange="-30 30"/>
<position joint="b" kp="30" kv="0.5" forcerange="-15 15"/></actuator></mujoco>"""


def test_what_comes_down_to_a_cycle_without_friction_is_not_called_unstable(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    loop = jx.robot(path, actuator="starleth", delay=0.0023)
    run = jx.simulate(loop, setpoint=0.4, duration=4.0, engine="mujoco")
    quarters = np.array_split(run.position.values, 4)
    before, previous, last = (np.ptp(quarter, axis=0) / 2.0 for quarter in quarters[1:])
    # Both joints get smaller ever faster; in 20 s of mj_step, written apart, they end up here.
    assert (previous - last > before - previous).all() and (before > previous).all()
    assert (last > [0.361, 0.953]).all()
    assert int(run.verdict) == Verdict.LIMIT_CYCLE
    assert "a longer one tells how small." in run.report.replace("\n", " ")
