"""What one actuator of a MuJoCo model does to its joint, as a law that a drive can take over.

With the moment G (gear, times the coefficient of a tendon over this one joint), the input u, and
the affine bias of MuJoCo, the joint feels

    f = G clip(g u + b0 + b1 G q + b2 G v, forcerange)

which for b1 < 0 is the PD law  kp (r - q) - kd v  with kp = -b1 G^2, kd = -b2 G^2 and the setpoint
r = (g u + b0) / (-b1 G); for b1 = 0, b2 < 0 and g = -b2 a velocity servo; and for b1 = b2 = 0 a
motor, whose force the input is. Formulas: MuJoCo's documentation, chapter Computation, "Actuation
model".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from jaxact.robots.findings import Finding, named, refused
from jaxact.robots.parity import unknown_to_mjx

POSITION = "position"
VELOCITY = "velocity"
FORCE = "force"

_GAIN, _BIAS, _DYN, _TRN = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn, mujoco.mjtTrn
_SINGLE = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
_FILTERS = (_DYN.mjDYN_FILTER, _DYN.mjDYN_FILTEREXACT)
_LEAVE = "name other joints in `joints = [...]` and it stays undriven"
# Bits of `actuator_ctrlspec` of a pid, in the order of its inputs.
_POSITION_INPUT, _VELOCITY_INPUT = 1, 2
# A first-order lag is a second-order one whose other pole is this much faster.
_FAST_POLE = 1000.0


class UndrivableError(Exception):
    """An actuator that no drive can replace; carries the finding that says why."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.advice)
        self.finding = finding


@dataclass(frozen=True)
class Law:
    """The law of an actuator at its joint; [N or N m], [m or rad], s.

    Attributes:
        index: of the actuator.
        kind: the element it is written with: "motor", "position", "general", ...
        joint: id of the joint.
        moment: joint force for a unit force of the actuator: gear, times a tendon's coefficient.
        commands: what its input asks for: `POSITION`, `VELOCITY` or `FORCE`.
        kp, kd: gains at the joint; nan for a motor.
        scale, offset: what is asked for is `offset + scale * input`, at the joint.
        integrated: whether the activation, the integral of the input, asks instead of the input.
        velocity_scale: velocity setpoint for a unit of the second input; 0 without one.
        force_low, force_high: limits of the joint force, +-inf where none.
        low, high: limits of what is asked for, +-inf where none.
        delay: of the input.
        lag: time constant of a first-order filter of the input; 0 without one.
        viscous: damping of the joint that a motor brings with it, [N m s/rad].
    """

    index: int
    kind: str
    joint: int
    moment: float
    commands: str
    kp: float
    kd: float
    scale: float
    offset: float
    integrated: bool
    velocity_scale: float
    force_low: float
    force_high: float
    low: float
    high: float
    delay: float
    lag: float
    viscous: float

    @property
    def lag_as_loop(self) -> tuple[float, float]:
        """wn [rad/s] and zeta of a force loop that equals the lag to a thousandth; nan if none."""
        if self.lag <= 0.0:
            return math.nan, math.nan
        slow, fast = 1.0 / self.lag, _FAST_POLE / self.lag
        wn = math.sqrt(slow * fast)
        return wn, 0.5 * (slow + fast) / wn


def label(model: mujoco.MjModel, index: int) -> str:
    """An actuator as messages name it."""
    return named("actuator", model.actuator(index).name, index)


def transmission(model: mujoco.MjModel, index: int) -> tuple[int, float]:
    """The one slide or hinge joint that an actuator acts on, and the moment there.

    Raises:
        UndrivableError: it acts on anything else.
    """
    kind = _TRN(model.actuator_trntype[index])
    target = int(model.actuator_trnid[index, 0])
    gear = float(model.actuator_gear[model.actuator_outadr[index], 0])
    if kind in (_TRN.mjTRN_JOINT, _TRN.mjTRN_JOINTINPARENT):
        joint, moment = target, gear
        what = named("joint", model.joint(joint).name, joint)
        if int(model.jnt_type[joint]) not in _SINGLE:
            ball = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL
            what = f"the {'ball' if ball else 'free'} {what}"
            raise _undrivable(model, index, "transmission", what, f"it acts on {what}")
    elif kind == _TRN.mjTRN_TENDON:
        joint, coefficient = _single_joint(model, index, target)
        moment = gear * coefficient
    else:
        what = _OTHER_TRANSMISSIONS.get(kind, "something else than a joint")
        raise _undrivable(model, index, "transmission", what, f"it acts through {what}")
    if moment == 0.0 or not math.isfinite(moment):
        raise _undrivable(
            model, index, "gear", f"{gear:g}", f"its gear is {gear:g}, so it can give no force"
        )
    return joint, moment


_OTHER_TRANSMISSIONS = {
    _TRN.mjTRN_SLIDERCRANK: "a slider-crank",
    _TRN.mjTRN_SITE: "a site",
    _TRN.mjTRN_BODY: "the contacts of a body (adhesion)",
    _TRN.mjTRN_SO3: "an orientation of three axes",
}


def _single_joint(model: mujoco.MjModel, index: int, tendon: int) -> tuple[int, float]:
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    what = named("tendon", model.tendon(tendon).name, tendon)
    if model.wrap_type[first] != mujoco.mjtWrap.mjWRAP_JOINT:
        raise _undrivable(
            model, index, "transmission", what, f"it pulls on {what}, which runs through space"
        )
    if len(wraps) > 1:
        joints = ", ".join(model.joint(int(model.wrap_objid[i])).name or "?" for i in wraps)
        raise _undrivable(
            model, index, "transmission", what, f"{what} couples several joints ({joints})"
        )
    return int(model.wrap_objid[first]), float(model.wrap_prm[first])


def law(model: mujoco.MjModel, index: int, kind: str) -> Law:
    """The law of an actuator.

    Args:
        model: as MuJoCo compiles it, so that ranges and damping ratios have become numbers.
        index: of the actuator.
        kind: the element it is written with.

    Raises:
        UndrivableError: it is neither a motor nor a linear servo on a single slide or hinge joint.
    """
    joint, moment = transmission(model, index)
    _refuse_what_is_not_linear(model, index, kind)
    gain, b0, b1, b2 = _affine(model, index)
    dynamics = _DYN(model.actuator_dyntype[index])
    first = int(model.actuator_ctrladr[index])
    pid = model.actuator_gaintype[index] == _GAIN.mjGAIN_PID
    inputs_of = int(model.actuator_ctrlspec[index])
    forces = _limits(model.actuator_forcelimited[index], model.actuator_forcerange[index])
    inputs = _limits(
        model.actuator_ctrllimited[first] and _clamps(model), model.actuator_ctrlrange[first]
    )
    if dynamics != _DYN.mjDYN_NONE:
        states = _limits(model.actuator_actlimited[index], model.actuator_actrange[index])
        integrated = dynamics == _DYN.mjDYN_INTEGRATOR
        inputs = states if integrated else _common(inputs, states)
    # a difference, as no gain is -0
    kp, kd, commands, viscous = 0.0 - b1 * moment**2, 0.0 - b2 * moment**2, POSITION, 0.0
    if b1 != 0.0:
        scale, offset = gain / (-b1 * moment), b0 / (-b1 * moment)
    elif b2 != 0.0 and gain == -b2:
        commands = VELOCITY
        scale, offset = 1.0 / moment, b0 / (gain * moment)
    else:
        commands, viscous = FORCE, kd
        kp = kd = math.nan
        scale, offset = moment * gain, moment * b0
    low, high = _scaled(inputs, scale, offset)
    force_low, force_high = _common(
        _scaled(forces, moment), _scaled(_tendon_limits(model, index), moment)
    )
    if commands == FORCE:
        force_low, force_high = _common((force_low, force_high), (low, high))
    _refuse_what_cannot_act(model, index, (kp, kd, viscous), scale, commands)
    return Law(
        index=index,
        kind=kind,
        joint=joint,
        moment=moment,
        commands=commands,
        kp=kp,
        kd=kd,
        scale=scale,
        offset=offset,
        integrated=dynamics == _DYN.mjDYN_INTEGRATOR,
        velocity_scale=1.0 / moment if pid and inputs_of & _VELOCITY_INPUT else 0.0,
        force_low=force_low,
        force_high=force_high,
        low=low,
        high=high,
        delay=_delay(model, index),
        lag=float(model.actuator_dynprm[index, 0]) if dynamics in _FILTERS else 0.0,
        viscous=viscous,
    )


def _affine(model: mujoco.MjModel, index: int) -> tuple[float, float, float, float]:
    """Gain g and bias b0, b1, b2."""
    b0, b1, b2 = (float(number) for number in model.actuator_biasprm[index, :3])
    if model.actuator_biastype[index] == _BIAS.mjBIAS_NONE:
        b0 = b1 = b2 = 0.0
    gain = float(model.actuator_gainprm[index, 0])
    if model.actuator_gaintype[index] == _GAIN.mjGAIN_PID:
        gain = -b1  # its input is the setpoint; its own parameter is the integral gain
    return gain, b0, b1, b2


def _refuse_what_is_not_linear(model: mujoco.MjModel, index: int, kind: str) -> None:
    gain, bias = _GAIN(model.actuator_gaintype[index]), _BIAS(model.actuator_biastype[index])
    dynamics = _DYN(model.actuator_dyntype[index])
    if model.actuator_plugin[index] >= 0:
        raise _undrivable(model, index, "type", "plugin", "a plugin computes its force")
    if gain == _GAIN.mjGAIN_PID and dynamics != _DYN.mjDYN_NONE:
        ki, slew = model.actuator_gainprm[index, 0], model.actuator_dynprm[index, 1]
        what = f"an integral part (ki = {ki:g})" if ki else f"a slew limit ({slew:g})"
        raise _undrivable(
            model, index, "ki" if ki else "slewmax", f"{ki or slew:g}",
            f"it is a pid with {what}, which the drive's PD controller has not",
        )  # fmt: skip
    if gain == _GAIN.mjGAIN_PID and not model.actuator_ctrlspec[index] & _POSITION_INPUT:
        raise _undrivable(model, index, "input", "no pos", "it is a pid without a position input")
    known = (
        gain in (_GAIN.mjGAIN_FIXED, _GAIN.mjGAIN_PID)
        and bias in (_BIAS.mjBIAS_NONE, _BIAS.mjBIAS_AFFINE)
        and dynamics in (_DYN.mjDYN_NONE, _DYN.mjDYN_INTEGRATOR, *_FILTERS, _DYN.mjDYN_PID)
    )
    if not known:
        what = _KINDS.get(
            kind, f"its law ({gain.name}, {bias.name}, {dynamics.name}) is not linear"
        )
        raise _undrivable(model, index, "type", kind, what)


_KINDS = {
    "dcmotor": "it is a dcmotor, whose electrical part no drive of jaxact has",
    "muscle": "it is a muscle",
    "damper": "it is a damper, which cannot follow a setpoint",
    "adhesion": "it is an adhesion",
    "orientation": "it is an orientation servo",
}


def _refuse_what_cannot_act(
    model: mujoco.MjModel,
    index: int,
    gains: tuple[float, float, float],
    scale: float,
    commands: str,
) -> None:
    if scale == 0.0 or not math.isfinite(scale):
        raise _undrivable(model, index, "gainprm", "0", "its gain is 0, so its input does nothing")
    if any(gain < 0.0 for gain in gains):  # nan, where a motor has none, is not
        value = " ".join(f"{number:g}" for number in model.actuator_biasprm[index, :3])
        raise _undrivable(
            model, index, "biasprm", value, "its bias pushes the joint away from the setpoint"
        )
    if model.actuator_dyntype[index] == _DYN.mjDYN_INTEGRATOR and commands != POSITION:
        raise _undrivable(
            model, index, "dyntype", "integrator", "it integrates its input into a force or speed"
        )


def _delay(model: mujoco.MjModel, index: int) -> float:
    """The delay of the input as MuJoCo carries it out [s].

    Held samples (interp "zoh") are delayed by whole steps, rounded up; none is older than the
    history buffer.
    """
    delay, step = float(model.actuator_delay[index]), float(model.opt.timestep)
    samples, interpolation = (int(number) for number in model.actuator_history[index])
    if delay <= 0.0:
        return 0.0
    steps = delay / step
    if interpolation == 0:
        steps = math.ceil(round(steps, 9))
    return min(steps, samples) * step


def _tendon_limits(model: mujoco.MjModel, index: int) -> tuple[float, float]:
    """Limits of the force on the tendon that this actuator pulls on."""
    if model.actuator_trntype[index] != _TRN.mjTRN_TENDON:
        return -math.inf, math.inf
    tendon = int(model.actuator_trnid[index, 0])
    return _limits(model.tendon_actfrclimited[tendon], model.tendon_actfrcrange[tendon])


def _clamps(model: mujoco.MjModel) -> bool:
    return not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL


def _limits(limited: object, bounds: np.ndarray) -> tuple[float, float]:
    return (float(bounds[0]), float(bounds[1])) if limited else (-math.inf, math.inf)


def _scaled(bounds: tuple[float, float], scale: float, offset: float = 0.0) -> tuple[float, float]:
    """Bounds of `offset + scale * x`; a negative scale turns them round."""
    if scale == 0.0 or not math.isfinite(scale):
        return -math.inf, math.inf
    ends = [offset + scale * bound for bound in bounds]
    return min(ends), max(ends)


def _common(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    return max(first[0], second[0]), min(first[1], second[1])


def _undrivable(
    model: mujoco.MjModel, index: int, field: str, value: str, reason: str
) -> UndrivableError:
    mjx = "refuses the model" if unknown_to_mjx(model, index) else "simulates it"
    return UndrivableError(refused(label(model, index), field, value, mjx, f"{reason}; {_LEAVE}"))
