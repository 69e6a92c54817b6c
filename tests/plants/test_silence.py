"""A simulation that fails says nothing and leaves no file; a handler that is set is kept."""

import mujoco
import numpy as np

from jaxact.robots.silence import silenced


def _fail():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[:] = np.nan
    mujoco.mj_step(model, data)


def test_a_warning_is_dropped(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    with silenced():
        _fail()
    said = capfd.readouterr()
    assert said.out == said.err == "" and list(tmp_path.iterdir()) == []
    assert mujoco.get_mju_user_warning() is None


def test_a_handler_that_is_there_hears_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    heard = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        with silenced():
            _fail()
        assert len(heard) == 1 and mujoco.get_mju_user_warning() is not None
    finally:
        mujoco.set_mju_user_warning(None)
