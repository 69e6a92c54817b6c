"""Gains as MuJoCo actuators that take the place of a model's own.

    force on the joint = G clip(kp_a (u - G q) - kv_a v_a, forcerange),   G = gear, v_a = G v

Everything that a default class or the joint's range could fill in is written out, so that an
element means the same wherever it stands.
"""

from __future__ import annotations

import math
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from jaxact.robots.robot import Joint, Robot


def actuators(robot: Robot, kp: np.ndarray, kd: np.ndarray) -> str:
    """An `<actuator>` section with the drives' gains and limits, inside `<mujoco>`.

    Args:
        robot: whose driven joints they are; names, gear and limits are its own.
        kp, kd: gains at the joints [N/m or N m/rad], per second; shape (joints,).

    Returns:
        The text. Lags and delays of the drives are not in it: MuJoCo's own are something else.
    """
    rows = [
        "    " + _element(robot, joint, float(p), float(d)) + "\n"
        for joint, p, d in zip(robot.joints, kp, kd, strict=True)
    ]
    notes = "".join(f"  <!-- {note} -->\n" for note in _notes(robot))
    return f"<mujoco>\n{notes}  <actuator>\n{''.join(rows)}  </actuator>\n</mujoco>\n"


def _element(robot: Robot, joint: Joint, kp: float, kd: float) -> str:
    gear = joint.gear
    limits = (joint.force_low / gear, joint.force_high / gear)
    setpoints = (joint.setpoint_low * gear, joint.setpoint_high * gear)
    model = robot.model
    group = model.actuator_group[np.flatnonzero(model.actuator_ctrladr == joint.index)[0]]
    written = {
        "name": joint.actuator,
        "joint": joint.name,
        "kp": repr(kp / gear**2),
        "kv": repr(kd / gear**2),
        "gear": f"{gear!r} 0 0 0 0 0",
        **_range("ctrl", *setpoints),
        **_range("force", *limits),
        "inheritrange": "0",
        "timeconst": "0",
        "delay": "0",
        "nsample": "0",
        **({"group": str(int(group))} if group else {}),
        **({"armature": repr(joint.own_armature)} if joint.own_armature else {}),
        **({"damping": repr(joint.own_damping)} if joint.own_damping else {}),
    }
    return "<position " + " ".join(f"{k}={quoteattr(v)}" for k, v in written.items()) + "/>"


def _range(name: str, *ends: float) -> dict[str, str]:
    """Limits, which a gear may have turned around; a side without one gets a number beyond all."""
    low, high = min(ends), max(ends)
    if math.isinf(low) and math.isinf(high):
        return {f"{name}limited": "false"}
    far = float(mujoco.mjMAXVAL)
    return {f"{name}limited": "true", f"{name}range": f"{max(low, -far)!r} {min(high, far)!r}"}


def _notes(robot: Robot) -> list[str]:
    """What a reader must know to use the section."""
    notes = [
        "They replace the elements of these names; ctrl is the setpoint of the joint times gear"
    ]
    if robot.damping == "drive":
        notes.append("kv stands for the damping of these joints too: give them damping 0")
    late = [joint.name for joint in robot.joints if joint.setpoint_delay > 0.0]
    if late:
        notes.append(f"left out: the model's delay of the setpoint of {', '.join(late)}")
    return [note.replace("--", "- -") for note in notes]
