"""Simulations in C MuJoCo side by side, against `mj_step` of one at a time."""

import mujoco
import numpy as np
import pytest
from robots import HOPPER

from jaxact.plants.mujoco import Impulse, Simulations
from jaxact.robots import model, posture

STEP = 1e-3
STEPS = 50


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    path = tmp_path_factory.mktemp("hopper") / "hopper.xml"
    path.write_text(HOPPER)
    robot = model.read(path)
    return robot, posture.settled(robot)


def _alone(robot, start, force, velocity, damping):
    """Configuration after some steps of `mj_step` under a constant force."""
    c_model = mujoco.MjModel.from_xml_string(HOPPER)
    c_model.opt.timestep = STEP
    c_model.dof_damping[:] = damping
    dofs = [joint.dof for joint in robot.joints]
    data = mujoco.MjData(c_model)
    data.qpos, data.ctrl = start.qpos, start.ctrl
    data.qvel[dofs] = velocity
    data.ctrl[[joint.index for joint in robot.joints]] = force
    for _ in range(STEPS):
        mujoco.mj_step(c_model, data)
    return data.qpos.copy()


def test_those_that_are_the_same_are_computed_once(standing):
    robot, start = standing
    joints = len(robot.joints)
    labels = np.array([7, 3, 3, 9, 7])
    force = start.force + 0.3 * labels[:, None]
    velocity = 0.01 * labels[:, None] * np.ones(joints)
    damping = 0.1 * labels[:, None] * np.ones(robot.model.nv)
    found = Simulations(
        robot, start, STEP, len(labels), same=labels, fields={"dof_damping": damping}
    )
    found.start(np.tile(start.joints(robot), (len(labels), 1)), velocity)
    for _ in range(STEPS):
        found.advance(force)
    ends = found.configuration()
    position, speed = np.moveaxis(found.measure(), 1, 0)
    assert ends.shape == (5, robot.model.nq) and position.shape == speed.shape == (5, joints)
    for place in range(len(labels)):
        want = _alone(robot, start, force[place], velocity[place], damping[place])
        np.testing.assert_allclose(ends[place], want, rtol=0, atol=1e-12)
        at = [joint.qpos for joint in robot.joints]
        np.testing.assert_array_equal(position[place], ends[place][at])
    assert np.ptp(ends, axis=0).max() > 1e-3
    assert found._batch.bind("qpos").shape[0] == 3


def test_a_push_reaches_all_of_them(standing):
    robot, start = standing
    push = Impulse(1, np.array([0.0, 0.0, 400.0]), 0.01, 0.02)
    rows = []
    for labels in (None, np.array([0, 0])):
        found = Simulations(robot, start, STEP, 2, same=labels, impulse=push)
        found.start(np.tile(start.joints(robot), (2, 1)), np.zeros((2, len(robot.joints))))
        for _ in range(STEPS):
            found.advance(np.tile(start.force, (2, 1)))
        rows.append(found.configuration())
    np.testing.assert_array_equal(*rows)
    assert np.abs(rows[0] - start.qpos).max() > 1e-3
