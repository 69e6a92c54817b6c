"""The margins of a whole robot as tables and as JSON."""

from __future__ import annotations

import json as _json
import math
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from jaxact.analysis.robot import modes
from jaxact.files import plain
from jaxact.loops.joint_units import of_joints
from jaxact.parameters import KD, KP, PARAMETERS
from jaxact.plotting.wording import physics_step, quantity
from jaxact.robots import mounting
from jaxact.verbs import changed_robot, rendering

if TYPE_CHECKING:
    from jaxact.analysis.robot.changes import Change
    from jaxact.analysis.robot.modes import Mode
    from jaxact.loops.specification import Specification
    from jaxact.robot_margins.stiction import Stiction
    from jaxact.robot_margins.whole_robot import WholeRobot

# Joints of a mode that are named.
_MOST_NAMED = 6
# Accelerations of a posture at rest are smaller [rad/s^2 or m/s^2].
RESIDUAL = 1e-2
# What falls or gives way grows faster than this [1/s].
_CREEP = 0.05
# Share of the delay margin from which on the integrator's lead is worth a word.
_COUNTS = 0.02
_WIDTH = 118


def title(specification: Specification) -> str:
    """The robot, its keyframe, and how it is mounted if not as its model has it."""
    plant = specification.plant
    assert plant is not None
    parts = [f"keyframe {plant.keyframe}"] if plant.keyframe else []
    parts += [f"base {plant.base}"] if plant.base != "free" else []
    parts += ["damping in the drive"] if plant.damping == "drive" else []
    parts += ["dry friction as stuck"] if plant.friction == "stuck" else []
    return ", ".join([plant.model.name, *parts])


def as_json(label: str, found: WholeRobot, stiction: Stiction | None) -> str:
    """All metrics as one object; null where one means nothing, "inf" for infinity."""
    plant, margins = found.specification.plant, found.margins
    assert plant is not None
    row: dict[str, Any] = {
        "model": str(plant.model), "keyframe": plant.keyframe, "posture": plant.posture,
        "base": plant.base, "damping": plant.damping, "friction": plant.friction, "loop": label,
        "engine": found.engine, "dry_friction_left_out": found.left_out,
        "residual": found.residual, **changed_robot.as_object(found),
        "neutral_directions": found.neutral, "control_period": found.robot.period,
        "physics_step": found.physics_step, "stable": margins.stable,
        "unstable_roots": margins.unstable_roots, "spectral_radius": margins.spectral_radius,
        "growth_rate": margins.growth_rate, "gain_to_boundary": margins.gain_to_boundary,
        "log_gain_to_boundary": margins.log_gain_to_boundary, "verdict": margins.verdict,
        "shaking_rate": margins.shaking_rate, "toppling_rate": margins.toppling_rate,
    }  # fmt: skip
    row["stiction"] = None if stiction is None else as_object(stiction)
    names = found.robot.names
    row["all"] = None if margins.whole is None else dict(vars(margins.whole))
    row["joints"] = [
        {"name": name, KP: float(kp), KD: float(kd)} | _of_joint(found, place)
        for place, (name, kp, kd) in enumerate(zip(names, found.kp, found.kd, strict=True))
    ]
    row["changes"] = {
        name: None if change is None else vars(change) | {"participation": _named(found, change)}
        for name, change in vars(margins.changes).items()
    }
    row["ranking"] = [names[place] for place in margins.ranking]
    for key, mode in (
        ("critical_mode", margins.critical),
        ("slowest_mode", margins.slowest),
        ("response_at_peak", margins.at_peak),
    ):
        row[key] = None if mode is None else vars(mode) | {"participation": _named(found, mode)}
    return _json.dumps(plain(row), allow_nan=False)


def _named(found: WholeRobot, motion: Mode | Change) -> dict[str, float]:
    """Share of each joint by its name."""
    return dict(zip(found.robot.names, motion.participation.tolist(), strict=True))


def as_object(stiction: Stiction) -> dict[str, Any]:
    """What dry friction holds, by name; null for a frequency that there is none of."""
    row = {name: value for name, value in vars(stiction).items() if name != "rotary"}
    return plain(row | {"sentence": stiction.sentence})


def _of_joint(found: WholeRobot, place: int) -> dict[str, Any]:
    """The margins of one joint by name, the phase margin in degrees; null for an unstable robot."""
    from jaxact.analysis.robot.margins import JointMargins

    names = [field.name for field in fields(JointMargins) if field.name != "name"]
    if not found.margins.stable:
        return dict.fromkeys(names)
    own = {name: getattr(found.margins.joints[place], name) for name in names}
    return own | {"phase_margin": math.degrees(own["phase_margin"])}


def as_text(label: str, found: WholeRobot, stiction: Stiction | None) -> str:
    """What there is to say of a robot, as lines and tables."""
    parts = [_head(label, found), _rendered(_whole_table(found))]
    if found.margins.stable:
        parts.append(
            "Each joint with all others closed, by its share in what shakes first:\n"
            + _rendered(_joint_table(found))
            + f"\n{_units(found)}; shakes, sways: shares in what shakes first, and in the least "
            "damped mode"
        )
    else:
        parts.append(_advice(found) + _stand(found))
    if stiction is not None:
        parts.append(f"The robot {stiction.sentence}.")
    return "\n\n".join(parts) + "\n"


def _head(label: str, found: WholeRobot) -> str:
    from jaxact.loops import robots

    plant = found.specification.plant
    assert plant is not None
    period, given = found.robot.period, found.specification.physics_step
    own = float(robots.scene(plant).robot.model.opt.timestep)
    step = physics_step(found.physics_step, own, period, asked=given is not None)
    count = len(found.robot.names)
    lines = [
        f"{title(found.specification)}{f': {label}' if label else ''}",
        f"{count} driven joint{'' if count == 1 else 's'}, control {1 / period:g} Hz, {step}, "
        f"{found.engine}, posture {plant.posture}, held by torques that are fed forward, "
        f"residual acceleration {found.residual:.2g}",
        *changed_robot.lines(found),
    ]
    if found.neutral:
        modes = "mode" if found.neutral == 1 else "modes"
        lines.append(f"{found.neutral} rigid-body {modes} removed")
    if found.left_out:
        lines.append(
            f"dry friction of up to {found.left_out:.3g} {of_joints('N', plant)} left out: these "
            "are the margins of joints that move, which it does not damp"
        )
    if plant.base == "held":
        lines.append(
            "base held: contacts that stick act as strong damping in the linearisation, so these "
            "are the margins of feet that never slip"
        )
    if ahead := _ahead(found):
        lines.append(
            f"MuJoCo's integrator has positions {1e3 * ahead:.3g} ms ahead of velocities, as no "
            "robot has them, which changes the delay margin by up to as much, and shifts gain "
            "margins and growth rates a little, too; `integrator_correction=True` takes it back"
        )
    if found.residual > RESIDUAL:
        lines.append(
            "warning: the posture is not an equilibrium (accelerations up to "
            f"{found.residual:.3g}); the metrics are those of the linearisation there, which the "
            "robot leaves"
        )
    return "\n".join(lines)


def _ahead(found: WholeRobot) -> float:
    """Half a physics step [s] where it is a part of the delay margin that counts, else 0."""
    from jaxact.loops import robots

    more, plant = found.margins.changes.more_delay, found.specification.plant
    assert plant is not None
    model = robots.scene(plant).robot.model
    if found.specification.integrator_correction or more is None:
        return 0.0
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return 0.0
    half = 0.5 * found.physics_step
    return half if half > _COUNTS * more.value else 0.0


def _whole_table(found: WholeRobot) -> Any:
    table = rendering.table("all joints at once", "")
    table.columns[1].justify = "left"
    margins = found.margins
    verdict = "creeps" if _creeps(found) else margins.verdict
    table.add_row("stable", "yes" if margins.stable else f"NO, it {verdict}")
    table.add_row("unstable roots", str(margins.unstable_roots))
    table.add_row("growth rate", f"{margins.growth_rate:.4g} 1/s")
    if margins.whole is not None:
        for name, value in _whole_rows(found):
            table.add_row(name, value)
    modes = [
        ("fastest growing mode" if not margins.stable else "least damped mode", margins.critical),
        ("slowest mode", margins.slowest if margins.stable else None),
        ("response at Ms", margins.at_peak),
    ]
    for name, mode in modes:
        if mode is not None:
            table.add_row(name, _mode(mode, found.robot.names))
    for name, value in _change_rows(found):
        table.add_row(name, value)
    return table


def _change_rows(found: WholeRobot) -> list[tuple[str, str]]:
    """Where it begins, or ceases, to shake and to topple."""
    margins = found.margins
    changes, verdict = margins.changes, margins.verdict
    shakes = "stops shaking" if "shakes" in verdict else "begins to shake"
    topples = "stops toppling" if "topples" in verdict else "begins to topple"
    rows = [
        (shakes, changes.more_gain, "gains ×{:.4g}"),
        (shakes, changes.less_gain, "gains ×{:.4g}"),
        (shakes, changes.more_delay, "{:.4g} ms more delay"),
        (shakes, changes.less_delay, "{:.4g} ms less delay"),
        (topples, changes.topple_more_gain, "gains ×{:.4g}"),
        (topples, changes.topple_less_gain, "gains ×{:.4g}"),
    ]
    return [
        (name, _change(change, form, found.robot.names))
        for name, change, form in rows
        if change is not None
    ]


def _change(change: Change, form: str, names: tuple[str, ...]) -> str:
    """`4.09 ms more delay, 150 rad/s: torso 34 %, ...`."""
    value = form.format(1e3 * change.value if "ms" in form else change.value)
    at = f", {change.frequency:.4g} rad/s" if change.frequency > 0.0 else ""
    return f"{value}{at}: {_shares(change.participation, names)}"


def _whole_rows(found: WholeRobot) -> list[tuple[str, str]]:
    whole = found.margins.whole
    assert whole is not None

    def at(frequency: float) -> str:
        return f" at {quantity(frequency, 'rad/s')}" if math.isfinite(frequency) else ""

    gain, disk = whole.gain_margin, whole.disk_margin
    decibel = f" ({20.0 * math.log10(gain):.1f} dB)" if math.isfinite(gain) else ""
    up = quantity(gain) + decibel + at(whole.gain_margin_frequency)
    rows = [
        ("gain margin", up),
        (
            "gain reduction margin",
            f"{whole.gain_reduction_margin:.4g}{at(whole.gain_reduction_frequency)}",
        ),
        ("delay margin", quantity(whole.delay_margin, "s") + at(whole.delay_margin_frequency)),
        (
            "Ms (peak of σmax S)",
            f"{whole.sensitivity_peak:.4g}{at(whole.sensitivity_peak_frequency)}",
        ),
        (
            "Mt (peak of σmax T)",
            f"{whole.complementary_peak:.4g}{at(whole.complementary_peak_frequency)}",
        ),
        ("disk margin", f"{disk:.4g}{at(whole.disk_margin_frequency)}"),
        (
            "  guarantees, of each joint",
            f"gains ×{max((2.0 - disk) / (2.0 + disk), 0.0):.3g} to "
            f"×{_upper(disk)}, phase ±{2.0 * math.degrees(math.atan(0.5 * disk)):.3g}°",
        ),
        ("  full-block uncertainty", f"{whole.unscaled_disk_margin:.4g}"),
    ]
    return [row for row in rows if row[0] != "gain reduction margin" or whole.gain_reduction_margin]


def _upper(disk: float) -> str:
    return f"{(2.0 + disk) / (2.0 - disk):.3g}" if disk < 2.0 else "∞"


def _mode(mode: Mode, names: tuple[str, ...]) -> str:
    """`4.58 rad/s, damping ratio 0.242, -1.14 1/s: LF_HAA 12 %, ...`."""
    if mode.frequency > 0.0:
        words = [f"{mode.frequency:.4g} rad/s"]
        words += [f"damping ratio {mode.damping_ratio:.3g}"] if mode.growth_rate else []
    else:
        words = ["no oscillation" if mode.growth_rate else "constant"]
    words += [f"{mode.growth_rate:.3g} 1/s"] if mode.growth_rate else []
    return f"{', '.join(words)}: {_shares(mode.participation, names)}"


def _shares(participation: np.ndarray, names: tuple[str, ...]) -> str:
    """`LF_HAA 12 %, LF_KFE 9 %, ...`."""
    if not participation.any():
        return "no driven joint"
    order = modes.ranked(participation)[:_MOST_NAMED]
    shares = [
        f"{names[i]} {100.0 * participation[i]:.0f} %" for i in order if participation[i] >= 0.01
    ]
    more = ", ..." if len(shares) == _MOST_NAMED < len(names) else ""
    return f"{', '.join(shares)}{more}"


def _joint_table(found: WholeRobot) -> Any:
    table = rendering.table(
        "joint", KP, KD, "disk", "Ms", "Mt", "gain", "down to", "phase [°]", "delay [ms]", "shakes",
        "sways", no_wrap=True, collapse_padding=True,
    )  # fmt: skip
    first, sway = found.margins.first_to_shake, found.margins.critical.participation
    for place in found.margins.ranking:
        own = found.margins.joints[place]
        metrics = (
            found.kp[place], found.kd[place], own.disk_margin, own.sensitivity_peak,
            own.complementary_peak, own.gain_margin, own.gain_reduction_margin,
            math.degrees(own.phase_margin), 1e3 * own.delay_margin,
        )  # fmt: skip
        cells = [f"{value:.4g}".replace("inf", "∞") for value in metrics]
        cells += ["" if shares is None else f"{100.0 * shares[place]:.0f} %"
                  for shares in (first, sway)]  # fmt: skip
        table.add_row(own.name, *cells)
    return table


def _units(found: WholeRobot) -> str:
    """Units of the columns with the gains."""
    plant = found.specification.plant
    assert plant is not None
    return ", ".join(f"{name} in {of_joints(PARAMETERS[name].unit, plant)}" for name in (KP, KD))


def _creeps(found: WholeRobot) -> bool:
    """Whether it only slides, as MuJoCo's contacts under load do at a rate of their softness."""
    margins, plant = found.margins, found.specification.plant
    held = plant is not None and plant.base == mounting.HELD
    return held and margins.verdict == "topples" and margins.toppling_rate < _CREEP


def _beside(found: WholeRobot) -> bool:
    """Whether what grows fastest is beside the robot: no driven joint moves, and its base neither.

    A robot that topples sideways over joints that swing forwards has no joint that moves, either.
    """
    return not (found.floating or found.margins.critical.participation.any())


def _advice(found: WholeRobot) -> str:
    if _creeps(found):
        return (
            "It does not shake; it creeps from its posture, by a factor of e in "
            f"{1.0 / found.margins.toppling_rate:.3g} s. MuJoCo's contacts slide slowly under "
            "load, against which these gains do not hold the joints; feet that stick stay where "
            "they are. The margins above are to where it begins to shake."
        )
    if found.margins.verdict == "topples" and _beside(found):
        return (
            "What grows fastest is a part of the model that no driven joint moves, whatever the "
            "gains. Margins of an unstable loop mean nothing; those above are to where it begins "
            "to shake."
        )
    if found.margins.verdict == "topples" and not found.floating:
        return (
            "It leaves its posture without shaking: the gains do not hold it there against weight, "
            "springs or contacts. Margins of an unstable loop mean nothing; those above are to "
            "where it begins to shake."
        )
    if found.margins.verdict == "topples":
        return (
            "It topples without shaking: what is missing is a balance controller, not another "
            "drive. Margins of an unstable loop mean nothing; those above are to where it begins "
            "to shake."
        )
    factor = found.margins.gain_to_boundary
    if factor is None:
        change = "no common factor on the gains makes it stable"
    else:
        change = f"the nearest change of stability is at a factor of {factor:.4g} on all gains"
    return f"Margins of an unstable loop mean nothing; {change}."


def _stand(found: WholeRobot) -> str:
    """Of a robot that topples: how the margins of its joints and drives are had."""
    plant = found.specification.plant
    topples = "topples" in found.margins.verdict
    if plant is None or plant.base != "free" or not topples or not found.floating:
        return ""
    return ' The robot topples on its free base; `base="fixed"` is it on a stand.'


def _rendered(table: Any) -> str:
    return rendering.rendered(table, width=_WIDTH).lstrip("\n")
