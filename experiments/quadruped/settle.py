"""Write the keyframes of the quadrupeds: postures at rest, with the torques that hold them.

    python experiments/quadruped/settle.py

A posture says where the feet are. Joint angles follow by inverse kinematics; then the trunk's
height, roll and pitch are moved (by less than a millimetre and a milliradian) until MuJoCo's
inverse dynamics at rest leave nothing on the trunk,

    M qacc + c - J' f = S' tau,   qacc = 0,   rows of the trunk: 0,

so that the contacts carry the weight and `tau`, stored as the keyframe's ctrl, holds the joints.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

HERE = Path(__file__).resolve().parent
LEGS = ("LF", "RF", "LH", "RH")
HEIGHT = 0.58  # of the hips above the ground [m]
STEP = 0.15  # how far the leg in the air is lifted [m]
LIFTED = "LF"
# Where the angles of the legs are searched from: knees inwards, as HyQ stands.
FRONT, HIND = (0.0, 0.75, -1.5), (0.0, -0.75, 1.5)
ARM = {"SAA": 0.0, "SFE": -1.1, "HR": 0.0, "EFE": 1.8, "WR": 0.0, "WFE": 0.0}
POSTURES = {
    "quadruped": ("stand", "three"),
    "quadruped_arm": ("stand", "three"),
    "quadruped_hung": ("hang",),
    "quadruped_arm_hung": ("hang",),
}


def compiled(name: str) -> mujoco.MjModel:
    """The model of this name without the keyframes that it has."""
    spec = mujoco.MjSpec.from_file(str(HERE / f"{name}.xml"))
    for key in list(spec.keys):
        spec.delete(key)
    return spec.compile()


def posture(model: mujoco.MjModel, name: str) -> mujoco.MjData:
    """The model at rest in a posture: stand, three (one leg in the air) or hang."""
    data = mujoco.MjData(model)
    for leg in LEGS:
        data.qpos[_angles(model, leg)] = FRONT if leg.endswith("F") else HIND
    for joint, angle in ARM.items():
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"arm_{joint}") >= 0:
            data.joint(f"arm_{joint}").qpos = angle
    if name == "hang":
        return _torques(model, data)
    data.qpos[2] = HEIGHT
    feet = _feet_below_the_hips(model, data)
    stance = [leg for leg in LEGS if name == "stand" or leg != LIFTED]
    for _ in range(20):
        _reach(model, data, {leg: feet[leg] for leg in stance})
        if name == "three":
            # equal loads: the centre of mass above the middle of the three feet
            middle = np.mean([feet[leg] for leg in stance], axis=0)
            data.qpos[:2] += (middle - data.subtree_com[0])[:2]
    if name == "three":
        lifted = _feet_below_the_hips(model, data)[LIFTED] + [0.0, 0.0, STEP]
        _reach(model, data, {LIFTED: lifted})
    return _balance(model, data)


def keyframe(name: str, data: mujoco.MjData) -> str:
    """A posture as the `key` element of a model file."""
    qpos, ctrl = (" ".join(f"{value:.12g}" for value in row) for row in (data.qpos, data.ctrl))
    return f'    <key name="{name}"\n         qpos="{qpos}"\n         ctrl="{ctrl}"/>\n'


def _angles(model: mujoco.MjModel, leg: str) -> list[int]:
    return [model.joint(f"{leg}_{joint}").qposadr[0] for joint in ("HAA", "HFE", "KFE")]


def _feet_below_the_hips(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, np.ndarray]:
    """Centres of the feet on the ground, straight below the hips."""
    mujoco.mj_forward(model, data)
    feet = {}
    for leg in LEGS:
        hip = data.body(f"{leg}_hipassembly").xpos
        feet[leg] = np.array([hip[0], hip[1], model.geom(f"{leg}_foot").size[0]])
    return feet


def _reach(model: mujoco.MjModel, data: mujoco.MjData, feet: dict[str, np.ndarray]) -> None:
    """Turn the joints of legs until their feet are there (Newton's method)."""
    jacobian = np.zeros((3, model.nv))
    for _ in range(30):
        mujoco.mj_forward(model, data)
        for leg, place in feet.items():
            foot = model.geom(f"{leg}_foot").id
            mujoco.mj_jacGeom(model, data, jacobian, None, foot)
            dofs = [model.joint(f"{leg}_{joint}").dofadr[0] for joint in ("HAA", "HFE", "KFE")]
            error = place - data.geom_xpos[foot]
            data.qpos[_angles(model, leg)] += np.linalg.solve(jacobian[:, dofs], error)
    mujoco.mj_forward(model, data)


def _balance(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Sink and tilt the trunk until the contacts carry the weight (Newton's method)."""
    moved = np.array([2, 3, 4])  # height, roll, pitch among the trunk's degrees of freedom
    data.qpos[2] -= 2e-4  # feet must touch for a derivative
    start = data.qpos.copy()
    shift = np.zeros(3)

    def residual(shift: np.ndarray) -> np.ndarray:
        tangent = np.zeros(model.nv)
        tangent[moved] = shift
        data.qpos[:] = start
        mujoco.mj_integratePos(model, data.qpos, tangent, 1.0)
        return _torques(model, data).qfrc_inverse[moved]

    for _ in range(50):
        now = residual(shift)
        steps = 1e-8 * np.eye(3)
        slope = np.stack([(residual(shift + step) - now) / 1e-8 for step in steps], axis=1)
        # short steps: the force of a contact is a curved function of its depth
        change = np.linalg.solve(slope, -now)
        shift += change * min(1.0, 1e-4 / np.abs(change).max())
    left = np.abs(residual(shift)).max()
    assert left < 1e-6, f"the trunk is not in equilibrium: {left} N or N m are left"
    return data


def _torques(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Fill in the torques that hold the joints where they are, by inverse dynamics at rest."""
    data.qvel[:] = 0.0
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    for actuator in range(model.nu):
        dof = model.jnt_dofadr[model.actuator_trnid[actuator, 0]]
        data.ctrl[actuator] = data.qfrc_inverse[dof]
    return data


def main() -> None:
    """Write `parts/<model>_keyframes.xml` of every model."""
    for name, postures in POSTURES.items():
        model = compiled(name)
        keys = "".join(keyframe(key, posture(model, key)) for key in postures)
        (HERE / "parts" / f"{name}_keyframes.xml").write_text(
            "<mujocoinclude>\n  <!-- Written by settle.py; do not edit. -->\n"
            f"  <keyframe>\n{keys}  </keyframe>\n</mujocoinclude>\n",
            encoding="utf-8",
        )


if __name__ == "__main__":
    main()
