"""The quadrupeds of the experiment: HyQ's size, at rest in every posture, and they stay there."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parent.parent / "experiments" / "quadruped"
LEGS = ("LF", "RF", "LH", "RH")
POSTURES = [
    ("quadruped", "stand"), ("quadruped", "three"), ("quadruped_hung", "hang"),
    ("quadruped_arm", "stand"), ("quadruped_arm", "three"), ("quadruped_arm_hung", "hang"),
]  # fmt: skip
ARM_GAINS = [(300, 6), (300, 6), (100, 2), (200, 3), (30, 0.3), (50, 0.5)]
GRAVITY = 9.81


def _model(name):
    return mujoco.MjModel.from_xml_path(str(FOLDER / f"{name}.xml"))


def _at(name, posture):
    model = _model(name)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(posture).id)
    mujoco.mj_forward(model, data)
    return model, data


def _gains(model):
    legs = [(800.0, 12.0)] * 12
    return np.array((legs + ARM_GAINS)[: model.nu]).T


def _held(model, data, seconds, *, push=None):
    """The torque that holds the posture, plus PD at every step; the largest speed of each step."""
    joints = model.actuator_trnid[:, 0]
    qpos, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    start, torque, (kp, kd) = data.qpos[qpos].copy(), data.ctrl.copy(), _gains(model)
    if push is not None:
        data.qvel[: len(push)] += push
    fastest = []
    for _ in range(round(seconds / model.opt.timestep)):
        data.ctrl[:] = torque + kp * (start - data.qpos[qpos]) - kd * data.qvel[dofs]
        mujoco.mj_step(model, data)
        fastest.append(np.abs(data.qvel).max())
    return np.array(fastest)


def _loads(model, data):
    """Upward force on each foot [N]."""
    loads, force = dict.fromkeys(LEGS, 0.0), np.zeros(6)
    for index in range(data.ncon):
        mujoco.mj_contactForce(model, data, index, force)
        loads[model.geom(data.contact[index].geom2).name[:2]] += force[0]
    return loads


def test_it_has_the_published_masses():
    model = _model("quadruped")
    leg = 3.44 + 3.146 + 0.881
    assert model.body_mass.sum() == pytest.approx(53.433 + 4 * leg)
    assert model.body_mass.sum() == pytest.approx(80.0, rel=0.1)
    assert _model("quadruped_arm").body_mass.sum() - model.body_mass.sum() == pytest.approx(12.0)


def test_it_has_the_published_size():
    model = _model("quadruped")
    hips = np.array([model.body(f"{leg}_hipassembly").pos for leg in LEGS])
    assert np.ptp(hips, axis=0) == pytest.approx([0.747, 0.414, 0.0])
    boxes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_BOX)
    trunk = boxes & (model.geom_bodyid == model.body("trunk").id)
    reach = np.abs(model.geom_pos[trunk, 0]) + model.geom_size[trunk, 0]
    assert 2.0 * reach.max() == pytest.approx(1.0, abs=0.05)
    for leg in LEGS:
        assert np.linalg.norm(model.body(f"{leg}_lowerleg").pos) == pytest.approx(0.35)
        assert np.linalg.norm(model.geom(f"{leg}_foot").pos) == pytest.approx(0.35)


@pytest.mark.parametrize("name", ["quadruped", "quadruped_arm", "quadruped_hung"])
def test_every_joint_has_a_plain_motor_of_limited_torque(name):
    model = _model(name)
    legs = [f"{leg}_{joint}" for leg in LEGS for joint in ("HAA", "HFE", "KFE")]
    names = [model.actuator(index).name for index in range(model.nu)]
    assert names[:12] == legs and len(names) == (18 if "arm" in name else 12)
    assert [model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)] == names
    assert (model.actuator_gear[:, 0] == 1.0).all()
    assert (model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED)).all()
    assert (model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_NONE)).all()
    assert model.actuator_forcelimited.all() and not model.actuator_ctrllimited.any()
    assert (model.actuator_forcerange[:12] == [-150.0, 150.0]).all()
    assert model.jnt_limited[model.actuator_trnid[:, 0]].all()


def test_the_legs_mirror_each_other():
    model = _model("quadruped")
    data = mujoco.MjData(model)
    for leg in LEGS:
        sign = 1.0 if leg.endswith("F") else -1.0
        data.joint(f"{leg}_HAA").qpos = 0.3
        data.joint(f"{leg}_HFE").qpos = 0.5 * sign
        data.joint(f"{leg}_KFE").qpos = -1.2 * sign
    mujoco.mj_forward(model, data)
    feet = np.array([data.geom(f"{leg}_foot").xpos for leg in LEGS]) - data.body("trunk").xpos
    assert feet[0] == pytest.approx(feet[1] * [1, -1, 1])
    assert feet[0] == pytest.approx(feet[2] * [-1, 1, 1])
    assert feet[0] == pytest.approx(feet[3] * [-1, -1, 1])
    assert abs(feet[0, 1]) < 0.207, "positive abduction angles turn a leg inwards"


@pytest.mark.parametrize(("name", "posture"), POSTURES)
def test_a_posture_is_at_rest_with_its_torques(name, posture):
    model, data = _at(name, posture)
    assert np.abs(data.qacc).max() < 1e-6
    assert (np.abs(data.ctrl) < 0.7 * model.actuator_forcerange[:, 1]).all()
    joints = model.actuator_trnid[:, 0]
    angles, limits = data.qpos[model.jnt_qposadr[joints]], model.jnt_range[joints]
    assert (angles > limits[:, 0]).all() and (angles < limits[:, 1]).all()


@pytest.mark.parametrize("name", ["quadruped", "quadruped_arm"])
def test_the_feet_carry_the_weight(name):
    weight = _model(name).body_mass.sum() * GRAVITY
    loads = _loads(*_at(name, "stand"))
    assert sum(loads.values()) == pytest.approx(weight) and min(loads.values()) > 0.1 * weight
    loads = _loads(*_at(name, "three"))
    assert loads.pop("LF") == 0.0
    assert sum(loads.values()) == pytest.approx(weight)
    assert list(loads.values()) == pytest.approx([weight / 3] * 3, rel=0.01)


def test_with_one_leg_in_the_air_the_centre_of_mass_is_inside_the_triangle():
    model, data = _at("quadruped", "three")
    corners = [data.geom(f"{leg}_foot").xpos[:2] for leg in ("RF", "RH", "LH")]
    centre = data.subtree_com[0, :2]
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        edge = there - here
        inside = edge[1] * (centre - here)[0] - edge[0] * (centre - here)[1]
        assert inside / np.linalg.norm(edge) > 0.08, "metres from an edge of the support"
    assert data.geom("LF_foot").xpos[2] > 0.1


def test_hung_feet_are_free_of_the_ground_and_the_trunk_is_held():
    model, data = _at("quadruped_hung", "hang")
    assert data.ncon == 0 and model.nv == 12
    assert min(data.geom(f"{leg}_foot").xpos[2] for leg in LEGS) > 0.2


@pytest.mark.parametrize(("name", "posture"), POSTURES)
def test_it_stands_still_for_five_seconds(name, posture):
    model, data = _at(name, posture)
    before = data.qpos.copy()
    fastest = _held(model, data, 5.0)
    assert np.abs(data.qpos - before).max() < 1e-8
    assert fastest.max() < 1e-7, "neither sliding nor jitter"


@pytest.mark.parametrize("posture", ["stand", "three"])
def test_a_push_dies_away(posture):
    model, data = _at("quadruped", posture)
    before = data.qpos.copy()
    fastest = _held(model, data, 5.0, push=[0.1, 0.05, 0.0])
    assert fastest[-500:].max() < 0.1 * fastest.max()
    assert np.abs(data.qpos - before)[7:].max() < 0.01


def test_only_feet_touch_and_only_the_ground():
    model = _model("quadruped")
    touching = {
        tuple(sorted((model.geom(i).name, model.geom(j).name)))
        for i in range(model.ngeom)
        for j in range(i)
        if (model.geom_contype[i] & model.geom_conaffinity[j])
        | (model.geom_contype[j] & model.geom_conaffinity[i])
    }
    assert touching == {tuple(sorted((f"{leg}_foot", "ground"))) for leg in LEGS}


@pytest.mark.parametrize("posture", ["stand", "three"])
def test_finite_differences_see_the_contacts(posture):
    """With PD all motions decay, except sliding in the plane and turning on the spot."""
    model, data = _at("quadruped", posture)
    n, (kp, kd) = model.nv, _gains(model)
    A, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, model.nu))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, A, B, None, None)
    select = np.zeros((model.nu, n))
    select[np.arange(model.nu), model.jnt_dofadr[model.actuator_trnid[:, 0]]] = 1.0
    closed = A - B @ np.hstack([kp[:, None] * select, kd[:, None] * select])
    rates = np.sort(np.log(np.abs(np.linalg.eigvals(closed))) / model.opt.timestep)[::-1]
    assert np.abs(rates[:3]).max() < 1e-2
    assert rates[3] < -0.3


def test_the_keyframes_are_those_that_settle_writes():
    specification = importlib.util.spec_from_file_location("settle", FOLDER / "settle.py")
    settle = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(settle)
    assert [(name, key) for name, keys in settle.POSTURES.items() for key in keys] == sorted(
        POSTURES, key=lambda pair: list(settle.POSTURES).index(pair[0])
    )
    for name, posture in POSTURES:
        model, data = _at(name, posture)
        settled = settle.posture(settle.compiled(name), posture)
        assert data.qpos == pytest.approx(settled.qpos, abs=1e-9)
        assert data.ctrl == pytest.approx(settled.ctrl, abs=1e-4)
