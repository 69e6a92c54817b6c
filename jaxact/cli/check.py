"""`jaxact check`: what will be driven in a robot, and what its model has that engines ignore."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from jaxact.cli import _arguments, _loops, _options
from jaxact.parameters import CONTROL_RATE

REFUSED = 1


def main(
    model: Annotated[Positional[Path], arg(metavar="MODEL", help="MJCF or URDF file of a robot.")],
    *,
    keyframe: _arguments.Keyframe = None,
    joints: _arguments.Joints = (".*",),
    posture: _arguments.Posture = None,
    base: _arguments.Base = None,
    damping: _arguments.Damping = None,
    gains: _arguments.Gains = None,
    control_rate: Annotated[
        float | None,
        _arguments.option(
            "HZ",
            "Of the controllers, at which the gains have to bear delay [Hz].",
            "1000, or the drive's",
        ),
    ] = None,
    drive: _arguments.DriveFile = None,
    json: Annotated[bool, arg(help="Print one JSON object.")] = False,
) -> None:
    r"""Show what will be driven in a robot and how, and every field that engines would ignore.

    First, where the model brings gains: how much delay they bear on a stand, and which joints shake
    then; where the joints' damping stands for a kd, the same with it in the drives and as the model
    has it; with dry friction as MuJoCo linearises it; and whether the robot stands with its base
    free. `jaxact margins` says more, with --set integrator_correction=true the same: MuJoCo's
    integrator, half a physics step ahead, is corrected for here, since no robot has it.

    For each joint: what the model has there, its gains and limits at the joint (gear applied), the
    inertia that the joint moves at the posture with all else free, the bandwidth of the PD loop
    (where its gain is 1, on that inertia), and delays. Then what needs a word: what MJX would do
    with it, and what jaxact does: lifted into the drive, emulated, ignored harmlessly, or refused.

    The file is never changed. Exit code 1 if anything is refused, 2 if there is no such model or
    keyframe, else 0.

    JSON: model, keyframe, digest, physics_step [s], degrees_of_freedom; engines that can simulate
    it (warp where it is installed); on_stand with control_rate [Hz], drive, outside (joints beyond
    their ranges), edges (what is said of joints on a limit), overloaded (joints too weak for the
    posture), hidden_gains (joints), friction, falls (why), and as_it_is, in_drive, stuck, free, of
    each joint, participation (shares of all), stable, shakes, topples, growth_rate, shaking_rate
    and toppling_rate [1/s], delay [s] and frequency [rad/s]; on_stand_not_known (why); joints with
    name, actuator, kind, kp, kd, force_limits, setpoint_limits, setpoint, setpoint_velocity, delay
    and setpoint_delay [s], natural_frequency [rad/s], damping_ratio, inertia, inertia_others_held,
    joint_damping, joint_friction, armature (what the joint itself has), bandwidth [rad/s]; findings
    with where, field, value, mjx, action, advice, engines. SI units; null: none.

    examples:
      jaxact check robot.xml --keyframe home
      jaxact check robot.xml --keyframe home --control-rate 500
      jaxact check robot.xml --joints '.*_hip' '.*_knee'
      jaxact check robot.xml --keyframe home --drive drive.toml
      jaxact check robot.urdf --json
    """
    mounted: dict[str, Any] = _arguments.mounted(posture=posture, base=base, damping=damping)

    from jaxact.loops.building import robot
    from jaxact.verbs.check import check

    if control_rate is not None:
        mounted[CONTROL_RATE] = control_rate
    identified = _loops.identified(drive, (), robot=True)
    found = check(
        robot(model, keyframe=keyframe, joints=joints, gains=gains, drive=identified, **mounted)  # type: ignore[arg-type]
    )
    print(_options.typed(found.to_json() if json else repr(found), "margins"))
    if found.refused:
        raise SystemExit(REFUSED)
