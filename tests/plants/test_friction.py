"""Linearised robots without dry friction, against the same robots whose files have none."""

import mujoco
import numpy as np
import pytest

from jaxact.plants import linearize
from jaxact.robots import friction, model, posture

STEP = 1e-3


def chain(seed, *, rubbing):
    """A random serial chain in gravity; `rubbing` has dry friction on some joints and a tendon."""
    random = np.random.default_rng(seed)
    joints = int(random.integers(2, 9))
    loss = np.where(random.random(joints) < 0.6, random.uniform(0.05, 2.0, joints), 0.0)
    loss[0] = loss[0] or 0.3
    rows, ends = [], []
    for i in range(joints):
        axis = " ".join(f"{x:.4f}" for x in random.normal(size=3))
        word = f'frictionloss="{loss[i]}"' if rubbing else ""
        rows.append(
            f'<body pos="0 0 {0.0 if i == 0 else -0.2}">'
            f'<joint name="j{i}" axis="{axis}" armature="{random.uniform(0.01, 0.1):.4f}" '
            f'damping="{random.uniform(0.0, 0.5):.4f}" {word}/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" '
            f'mass="{random.uniform(0.2, 2.0):.3f}" contype="0" conaffinity="0"/>'
        )
        ends.append("</body>")
    tendon = 'frictionloss="0.2"' if rubbing else ""
    start = " ".join(f"{x:.4f}" for x in random.uniform(-1.0, 1.0, joints))
    motors = "".join(f'<motor joint="j{i}"/>' for i in range(joints))
    return (
        f"<mujoco><worldbody>{''.join(rows)}{''.join(ends)}</worldbody>"
        f'<tendon><fixed {tendon}><joint joint="j0" coef="1"/><joint joint="j1" coef="-1"/></fixed>'
        f"</tendon><actuator>{motors}</actuator>"
        f'<keyframe><key name="home" qpos="{start}"/></keyframe></mujoco>'
    )


def placed(path, text):
    path.write_text(text, encoding="utf-8")
    robot = model.read(path, keyframe="home")
    return robot, posture.settled(robot)


@pytest.mark.parametrize("seed", range(20))
def test_moving_chains_are_those_without_friction(tmp_path, seed):
    rubbing = placed(tmp_path / "rubbing.xml", chain(seed, rubbing=True))
    smooth = placed(tmp_path / "smooth.xml", chain(seed, rubbing=False))
    moving = friction.moving(*rubbing)
    expected = linearize.linearise_c(*smooth, STEP)
    found = linearize.linearise_c(*moving, STEP)
    for ours, theirs in zip(found[:2], expected[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-7)
    assert found[2] < 1e-6  # at rest without friction, too
    stuck = linearize.linearise_c(*rubbing, STEP)
    assert np.abs(stuck[0] - expected[0]).max() > 1e-2


def test_friction_of_undriven_joints_shows_as_residual(tmp_path):
    text = """<mujoco><worldbody>
    <body><joint name="driven" axis="0 1 0" armature="0.1"/><geom size="0.1" mass="1"/>
    <body pos="0.3 0 0"><joint name="loose" axis="0 1 0" frictionloss="50"/>
    <geom size="0.1" mass="1" pos="0.2 0 0" contype="0" conaffinity="0"/></body></body></worldbody>
    <actuator><motor joint="driven"/></actuator><keyframe><key name="home"/></keyframe></mujoco>"""
    path = tmp_path / "loose.xml"
    path.write_text(text, encoding="utf-8")
    robot = model.read(path, keyframe="home")
    _, there = friction.moving(robot, posture.given(robot))
    assert there.residual > 10.0  # it would fall: 1 kg on 0.2 m


def test_without_friction_nothing_changes(tmp_path):
    robot, there = placed(tmp_path / "smooth.xml", chain(3, rubbing=False))
    assert friction.moving(robot, there) == (robot, there)
    assert not friction.rubs(robot.model)


def test_contacts_and_limits_stay(tmp_path):
    """A foot on the floor: the contact's stiffness is in the linear plant."""
    text = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
    <body pos="0 0 0.1"><joint name="lift" type="slide" axis="0 0 1" frictionloss="{loss}"/>
    <geom size="0.1" mass="1"/></body></worldbody>
    <actuator><motor joint="lift"/></actuator><keyframe><key name="home" qpos="-0.001"/></keyframe>
    </mujoco>"""
    rubbing = placed(tmp_path / "a.xml", text.format(loss=5.0))
    moving = friction.moving(*rubbing)
    smooth, _ = placed(tmp_path / "b.xml", text.format(loss=0.0))
    # The same configuration: friction may have stopped it elsewhere on its contact.
    data = mujoco.MjData(smooth.model)
    data.qpos = moving[1].qpos
    A, _, _ = linearize.linearise_c(*moving, STEP)
    expected, _, _ = linearize.linearise_c(smooth, moving[1], STEP)
    np.testing.assert_allclose(A, expected, atol=1e-9)
    assert A[1, 0] < -0.1  # the contact's stiffness
