"""What must hold between the parts of a specification, checked before anything runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from jaxact.errors import UserError
from jaxact.loops import torque_speed
from jaxact.loops.axes import MOST_LOOPS, Axis
from jaxact.loops.specification import Specification
from jaxact.parameters import (
    CONTROL_RATE,
    DELAY,
    DELAYS,
    JOINT_STIFFNESS,
    MASS,
    OUTPUT_DELAY,
    POLICY_RATE,
    ROBOT_ONLY,
    SETPOINT,
    VELOCITY_BIAS,
    VELOCITY_BIAS_WALK,
    VELOCITY_FILTER,
    VELOCITY_NOISE,
    VELOCITY_RESOLUTION,
    WN,
    ZETA,
    base,
    of,
)

# Longest history of a signal that a loop keeps, in control periods.
LONGEST_HISTORY = 4096
# The filter of the differenced velocity, and the sensor of the sampled one.
OF_VELOCITY = (
    VELOCITY_FILTER, VELOCITY_RESOLUTION, VELOCITY_NOISE, VELOCITY_BIAS, VELOCITY_BIAS_WALK,
)  # fmt: skip
# What only a single joint has, and where a robot has it.
JOINT_ONLY = {
    JOINT_STIFFNESS: "a robot's springs are those of its model",
    MASS: "a robot's masses are those of its model; payload and inertia_scale change them",
}
# Most physics steps of one rollout.
MOST_STEPS = 100_000_000
FEWEST_CONTROL_PERIODS = 10


def check(specification: Specification) -> None:
    """Raise UserError if the parts of a specification do not fit each other."""
    axes = {axis.name: axis for axis in specification.axes}
    _check_robot_only(specification, axes)
    _check_axes(specification, axes)
    _check_actuator(specification, axes)
    torque_speed.check_specification(specification, axes)
    _check_velocity(specification, axes)
    rates = _rates(specification, axes)
    _check_policy(specification, axes, rates)
    _check_steps(specification, rates)
    _check_duration(specification, rates)
    _check_delays(specification, axes, rates)
    _check_push(specification)
    _check_motion(specification, axes)


def physics_step(specification: Specification, control_rate: float) -> float:
    """Step of the plant [s] of a loop with this control rate [Hz].

    Of a robot the longest one possible: its own is found when its model is read, see
    `jaxact.simulation.plans.substeps`.
    """
    if specification.physics_step is not None:
        return specification.physics_step
    engine = specification.simulator
    return (engine.step if engine else None) or 1.0 / control_rate


def _check_axes(specification: Specification, axes: dict[str, Axis]) -> None:
    if not axes:
        raise UserError("axes: none given; name at least one parameter to vary below [axes]")
    sampling = specification.sampling
    drawn = any(axis.sampled for axis in axes.values())
    if sampling is not None and not drawn:
        raise UserError(
            "sampling: no axis is a range { min, max } to draw from; give one, or drop it"
        )
    total = math.prod(len(axis) for axis in axes.values()) * (sampling.samples if sampling else 1)
    if total > MOST_LOOPS:
        sizes = " x ".join(f"{axis.name} {len(axis):,}" for axis in axes.values())
        raise UserError(f"axes: {sizes} make {total:.3g} samples; allowed: up to {MOST_LOOPS:,}")


def _check_robot_only(specification: Specification, axes: dict[str, Axis]) -> None:
    """What only a robot has would be ignored silently without one, and the other way round."""
    if specification.robot:
        if specification.unit is not None:
            raise UserError("unit: only for a single joint; a robot's joints have their own")
        for name in (*specification.parameters, *axes):
            if base(name) in JOINT_ONLY:
                raise UserError(f"{name}: only for a single joint; {JOINT_ONLY[base(name)]}")
        return
    for name in (*specification.parameters, *axes):
        if "@" in name or name in ROBOT_ONLY:
            raise UserError(f"{name}: only a robot has it; give one below [plant], or drop it")
    for name in ("motion", "push"):
        if getattr(specification, name) is not None:
            raise UserError(f"{name}: only for a robot; give one below [plant], or drop it")


def _check_actuator(specification: Specification, axes: dict[str, Axis]) -> None:
    given = {*axes, *specification.parameters}
    twice = [name for name in (WN, ZETA) if name in given]
    if "actuator" in given and twice:
        raise UserError(f"{twice[0]}: the actuator preset sets it already; remove one of the two")


def _check_velocity(specification: Specification, axes: dict[str, Axis]) -> None:
    """What the sensor of the other kind of velocity has would be ignored silently."""
    differenced = specification.velocity == "differenced"
    for name, value in specification.parameters.items():
        if base(name) in OF_VELOCITY and not isinstance(value, str):
            check_velocity(name, [value], f"parameters.{name}", differenced=differenced)
    for name, axis in axes.items():
        if base(name) in OF_VELOCITY:
            check_velocity(name, axis.ends, f"axes.{name}", differenced=differenced)


def check_velocity(name: str, values: Iterable[float], key: str, *, differenced: bool) -> None:
    """Raise UserError for a parameter that the velocity's sensor of the other kind has.

    Args:
        name: of the parameter, or its key for some joints.
        values: that it has.
        key: how the message names it.
        differenced: whether the velocity is differenced.
    """
    on_differenced = base(name) == VELOCITY_FILTER
    if on_differenced == differenced or all(value == of(name).default for value in values):
        return
    if on_differenced:
        raise UserError(
            f"{key}: filters differenced positions, and a sampled velocity has no such filter;"
            ' allowed: with velocity "differenced"'
        )
    raise UserError(
        f"{key}: is of the velocity's own sensor, which a differenced position does without;"
        ' allowed: with velocity "sampled"'
    )


def _rates(specification: Specification, axes: dict[str, Axis]) -> np.ndarray:
    """Control rates [Hz] that occur, the ends only where they are drawn from a range."""
    if CONTROL_RATE not in axes:
        return np.array([specification.nominal[CONTROL_RATE]])
    axis = axes[CONTROL_RATE]
    engine = specification.simulator
    whatever = engine is not None and engine.exact and specification.physics_step is None
    if axis.sampled and not whatever:
        raise UserError(
            "axes.control_rate: drawn from a range its period is not a multiple of the physics "
            "step; give a list of rates"
        )
    return np.array(axis.ends) if axis.sampled else axis.values


def _check_policy(specification: Specification, axes: dict[str, Axis], rates: np.ndarray) -> None:
    """A policy ticks with the controller, every so many periods."""
    policy = axes.get(POLICY_RATE)
    given = np.array([specification.nominal[POLICY_RATE]]) if policy is None else policy.values
    if policy is not None and policy.sampled:
        raise UserError("axes.policy_rate: drawn from a range it divides no rate; give a list")
    slow = given[np.isfinite(given)]
    if not len(slow):
        return
    if CONTROL_RATE in axes and axes[CONTROL_RATE].sampled:
        raise UserError("axes.control_rate: drawn from a range, no policy_rate divides it")
    for rate in rates:
        for policy_rate in slow:
            check_policy_rate(float(policy_rate), float(rate))


def check_policy_rate(policy_rate: float, rate: float) -> None:
    """Raise UserError for a policy that does not tick with the controller.

    Args:
        policy_rate: [Hz], finite.
        rate: control rate [Hz].
    """
    ticks = rate / policy_rate
    if round(ticks) < 1 or abs(ticks - round(ticks)) > 1e-6 * ticks:
        allowed = rate / max(math.ceil(ticks), 1)
        raise UserError(
            f"policy_rate = {policy_rate:g} Hz does not divide the control rate {rate:g} Hz;"
            f" allowed e.g.: {allowed:.9g}"
        )


def _check_steps(specification: Specification, rates: np.ndarray) -> None:
    for rate in rates:
        step = physics_step(specification, rate)
        ratio = 1.0 / (rate * step)
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            above = 1.0 / (rate * max(math.ceil(ratio), 1))
            raise UserError(
                f"control_rate = {rate:g} Hz: its period {1 / rate:g} s is not a multiple of the"
                f" physics step {step:g} s; allowed e.g.: physics_step = {above:.9g}"
            )


def _check_duration(specification: Specification, rates: np.ndarray) -> None:
    shortest = shortest_duration(float(rates.min()))
    steps = specification.duration / physics_step(specification, float(rates.max()))
    if specification.duration < shortest * (1 - 1e-9):
        raise UserError(
            f"duration = {specification.duration:g}; allowed: at least {shortest:g} s,"
            f" {FEWEST_CONTROL_PERIODS} control periods"
        )
    if steps > MOST_STEPS:
        raise UserError(
            f"duration = {specification.duration:g} is {steps:.3g} physics steps;"
            f" allowed: up to {MOST_STEPS:,}"
        )


def shortest_duration(control_rate: float) -> float:
    """The shortest duration of a simulation at a control rate [Hz], in seconds."""
    return FEWEST_CONTROL_PERIODS / control_rate


def _check_push(specification: Specification) -> None:
    """Verdicts compare the motion of the last quarters of a rollout, which a push would disturb."""
    push = specification.push
    if push is None:
        return
    end, latest = push.time + push.duration, 0.5 * specification.duration
    if end > latest * (1 + 1e-9):
        raise UserError(
            f"push: ends at {end:g} s; allowed: within the first half of the duration, up to"
            f" {latest:g} s, so that what is left shows whether the motion dies out"
        )


def _check_motion(specification: Specification, axes: dict[str, Axis]) -> None:
    """A setpoint beside positions from a file would be ignored silently."""
    if specification.motion is None or specification.motion.kind != "file":
        return
    given = [name for name, value in specification.parameters.items() if value != 0.0]
    for name in (*given, *axes):
        if base(name) == SETPOINT:
            raise UserError(
                f"{name}: motion.file says where the setpoints are; remove one of the two"
            )


def _check_delays(specification: Specification, axes: dict[str, Axis], rates: np.ndarray) -> None:
    """Of all joints, and of those that a pattern gives delays of their own."""
    given = specification.nominal | {
        name: axis.ends[1] for name, axis in axes.items() if base(name) in DELAYS
    }
    patterns = dict.fromkeys(name[len(base(name)) :] for name in given if base(name) in DELAYS)
    for at in patterns:
        longest = {name: given.get(name + at, given[name]) for name in DELAYS}
        # what only the model knows is at least 0
        longest = {name: float(np.nan_to_num(value)) for name, value in longest.items()}
        check_history(longest, float(rates.max()), at=at)


def check_history(
    values: Mapping[str, float], rate: float, where: str = "", *, at: str = ""
) -> None:
    """Raise UserError for delays [s] that are longer than what a loop keeps at a control rate [Hz].

    Args:
        values: parameters of the loop by name, all delays among them.
        where: what a message begins with.
        at: `@` and the pattern of the joints whose delays they are; "" for all joints.
    """
    longest = {name: values[name] for name in DELAYS}
    # the command and the output delay are one line
    longest[OUTPUT_DELAY] += longest[DELAY]
    most = LONGEST_HISTORY / rate
    for name, value in longest.items():
        if value > most * (1 + 1e-9):
            words = f"{DELAY}{at} + {OUTPUT_DELAY}{at}" if name == OUTPUT_DELAY else name + at
            raise UserError(
                f"{where}{words} = {value:g}: a loop's history holds {LONGEST_HISTORY} control"
                f" periods; allowed: up to {most:g} s at {rate:g} Hz"
            )
