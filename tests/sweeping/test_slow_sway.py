"""Robots that sway too slowly for a quarter of a run to show it, with encoders."""

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.status import Verdict

# A long arm on a soft servo: it sways in a second and a half, longer than a quarter of its run.
SOFT = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body>
<joint name="arm" axis="0 0 1" armature="0.5"/><geom size="0.05" mass="0.1"/></body></worldbody>
<actuator><position joint="arm" kp="9" kv="1.2"/></actuator></mujoco>"""


@pytest.mark.exhaustive
def test_a_slow_sway_with_an_encoder_is_no_limit_cycle(tmp_path):
    path = tmp_path / "soft.xml"
    path.write_text(SOFT)
    plain = mujoco.MjModel.from_xml_string(SOFT)
    data = mujoco.MjData(plain)
    data.ctrl[:] = 0.05
    least, most = np.inf, -np.inf
    while data.time < 20.0:
        mujoco.mj_step(plain, data)
        if data.time > 15.0:
            least, most = min(least, data.qpos[0]), max(most, data.qpos[0])
    assert most - least < 1e-7
    arm = jx.robot(path, control_rate=500.0, position_resolution=1e-4)
    for duration in (1.5, 2.0):
        run = jx.simulate(arm, setpoint=0.05, duration=duration)
        assert int(run.verdict) == Verdict.STABLE
