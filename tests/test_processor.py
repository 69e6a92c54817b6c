"""Where there is a GPU, programs that compute little run on the processor.

Here the second of two devices stands for the processor, and the first one for the GPU.
"""

import contextlib

import jax
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

import jaxact as jx
from jaxact.compilation import processor, programs
from jaxact.simulation import mujoco_batch


@pytest.fixture
def elsewhere(monkeypatch):
    """The devices that programs of no `devices` were started on meanwhile."""
    used = set()
    called = programs.Program.__call__

    def watched(self, *inputs, **static):
        found = called(self, *inputs, **static)
        if "devices" not in static:
            used.update(device for leaf in jax.tree.leaves(found) for device in leaf.devices())
        return found

    programs.let_go()
    monkeypatch.setattr(processor, "_other_device", lambda: jax.devices()[1])
    monkeypatch.setattr(programs.Program, "__call__", watched)
    yield used
    programs.let_go()


@contextlib.contextmanager
def as_usual():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(processor, "_other_device", lambda: None)
        programs.let_go()
        yield
        programs.let_go()


def same(function, used):
    """What a function gives there is what it gives where JAX computes by itself."""
    found = function()
    assert used == {jax.devices()[1]}
    used.clear()
    with as_usual():
        usual = function()
    assert used == {jax.devices()[0]}
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(usual), strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


@pytest.mark.exhaustive
def test_margins_of_joints(elsewhere):
    loop = jx.joint(kp=[200.0, 400.0], kd=20, actuator="hyq", delay=1e-3)
    same(lambda: jx.margins(loop).found, elsewhere)


@pytest.mark.exhaustive
def test_margins_of_arrays_that_are_on_the_gpu(elsewhere):
    there = jax.device_put(np.array([200.0, 400.0], np.float32), jax.devices()[0])
    found = jx.margins(jx.joint(kp=there, kd=20, actuator="hyq", delay=1e-3)).delay_margin
    usual = jx.margins(jx.joint(kp=np.asarray(there), kd=20, actuator="hyq", delay=1e-3))
    np.testing.assert_array_equal(found, usual.delay_margin)


@pytest.mark.exhaustive
def test_a_robot_in_c_mujoco(elsewhere, tmp_path):
    (tmp_path / "robot.xml").write_text(PENDULUM)
    loop = jx.robot(tmp_path / "robot.xml", kp=60, kd=3, actuator="hyq", delay=2e-3)

    def simulated():
        mujoco_batch.template.cache_clear()
        run = jx.simulate(loop, setpoint=0.1, duration=0.05)
        return run.position.values, run.force.values

    same(simulated, elsewhere)


@pytest.mark.exhaustive
def test_gains_of_a_joint(elsewhere):
    loop = jx.joint(mass=0.7, actuator="hyq", delay=1e-3)
    same(lambda: jx.tune(loop, max_peak=1.6).loop.values["kp"], elsewhere)


def test_who_chose_a_device_gets_it(elsewhere):
    loop = jx.joint(kp=400, kd=20, actuator="hyq", delay=1e-3)
    with jax.default_device(jax.devices()[0]):
        jx.margins(loop)
    assert elsewhere == {jax.devices()[0]}


def test_here_nothing_is_moved():
    assert isinstance(processor.on_processor(), contextlib.nullcontext)
    assert processor.platform() == "cpu"
