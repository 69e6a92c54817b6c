"""Gains of a robot held against nonlinear rollouts with everything its drives have.

Noise, quantisation, limits, contacts and a push, in every posture and with every member of an
ensemble of drives: the same rollouts and the same verdicts as those of a sweep.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxact.errors import UserError
from jaxact.loops import robots
from jaxact.loops.robots import Scene
from jaxact.loops.samples import explicit
from jaxact.loops.specification import Specification
from jaxact.parameters import FEEDFORWARD, GAIN_SCALE, KD, KP, check, known
from jaxact.robots import posture as _posture
from jaxact.simulation import engines as _engines
from jaxact.simulation import single
from jaxact.status import Verdict
from jaxact.tuning.course import Told, silent
from jaxact.tuning.result import Tuned
from jaxact.tuning.rollouts.exposure import exposed
from jaxact.tuning.rollouts.motion import Motion, Sides, motions

Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Validation:
    """What the rollouts of p postures with n members each ended as; m joints.

    Attributes:
        situations: names of the postures.
        joints: names of the joints.
        verdict: codes of `jaxact.status.Verdict`, shape (p, n); a robot that falls is unstable.
        growth_rate: of small perturbations of the linearised loops [1/s], shape (p, n).
        excursion: largest distance of each joint from its setpoint [rad or m], shape (p, n, m).
        fallen: whether a floating robot had turned over or sunk in the end, shape (p, n).
        reasons: a sentence for each, p rows of n.
        engines: that simulated each posture, "mjx", "mujoco" or "warp".
        motions: of the joints in each rollout, p rows of n.
    """

    situations: tuple[str, ...]
    joints: tuple[str, ...]
    verdict: np.ndarray
    growth_rate: np.ndarray
    excursion: np.ndarray
    fallen: np.ndarray
    reasons: tuple[tuple[str, ...], ...]
    engines: tuple[str, ...]
    motions: tuple[tuple[tuple[Motion, ...], ...], ...]

    @property
    def stable(self) -> np.ndarray:
        """Which rollouts came to rest, shape (p, n)."""
        return self.verdict == Verdict.STABLE

    @property
    def worst(self) -> tuple[str, int, str]:
        """Posture, number of the member and reason of the rollout that went worst.

        By its verdict, then by the growth rate.
        """
        row, column = self._worst
        return self.situations[row], column, self.reasons[row][column]

    @property
    def _worst(self) -> tuple[int, int]:
        order = np.lexsort((self.growth_rate.ravel(), self.verdict.ravel()))
        row, column = np.unravel_index(order[-1], self.verdict.shape)
        return int(row), int(column)

    @property
    def badness(self) -> tuple[int, float]:
        """Verdict and growth rate of the worst: what rollouts of postures are compared by."""
        place = self._worst
        return int(self.verdict[place]), float(self.growth_rate[place])


@dataclass(frozen=True)
class Rollouts:
    """Tuned gains held against nonlinear rollouts, in every situation with every member.

    Attributes:
        duration: of each rollout [s].
        after, before: by name of the situation; `before` is empty without a start.
    """

    duration: float
    after: Mapping[str, Validation]
    before: Mapping[str, Validation]

    @property
    def stable(self) -> tuple[int, int]:
        """How many of the rollouts with the tuned gains were stable, and of how many."""
        verdicts = [one.stable for one in self.after.values()]
        return sum(int(v.sum()) for v in verdicts), sum(v.size for v in verdicts)

    @property
    def shown(self) -> tuple[str, int]:
        """Situation and number of the member that the tuned gains do worst with."""
        name = max(self.after, key=lambda one: self.after[one].badness)
        return name, self.after[name].worst[1]

    @property
    def verdicts(self) -> dict[str, str]:
        """What became of that member, by the name of the gains, those of the start first."""
        name, member = self.shown
        return {
            side: f"{Verdict(int(one[name].verdict[0, member])).label}: "
            f"{one[name].reasons[0][member]}"
            for side, one in self._sides.items()
        }

    @property
    def motions(self) -> Sides:
        """How it moved."""
        name, member = self.shown
        return {
            side: dict(zip(one[name].joints, one[name].motions[0][member], strict=True))
            for side, one in self._sides.items()
        }

    @property
    def _sides(self) -> dict[str, Mapping[str, Validation]]:
        return ({"before": self.before} if self.before else {}) | {"tuned": self.after}


def rollouts(tuned: Tuned, duration: float, told: Told = silent) -> Rollouts:
    """Simulate a robot's gains before and after with everything that the drives have.

    Args:
        duration: of each rollout [s].
        told: what is being done.
    """
    assert tuned.robot is not None
    loops = tuned.robot.case.table.loops
    total, number = len(loops) * (2 if tuned.before else 1), itertools.count(1)

    def ended() -> None:
        told("simulating", next(number), total)

    told("simulating", 0, total)

    def held(kp: np.ndarray, kd: np.ndarray) -> dict[str, Validation]:
        assert tuned.robot is not None
        return {
            one.name: validate(
                {one.name: exposed(one.specification, duration=duration)}, kp, kd,
                one.columns(loops.fraction[loops.situation == place]), ended=ended,
            )
            for place, one in enumerate(tuned.robot.situations)
        }  # fmt: skip

    after = held(tuned.kp, tuned.kd)
    return Rollouts(duration, after, held(*tuned.before) if tuned.before else {})


def validate(
    situations: Mapping[str, Specification],
    kp: np.ndarray,
    kd: np.ndarray,
    members: Columns,
    *,
    engine: str | None = None,
    ended: Callable[[], None] = lambda: None,
) -> Validation:
    """Simulate gains in every posture with every member.

    The same gains scaled, or other ones, compile nothing anew.

    Args:
        situations: specifications with a plant by name of the posture; what they say of gains and
            of what the members differ in does not matter. `jaxact.tuning.rollouts.exposure.exposed`
            completes them.
        kp, kd: of the joints in the order of the first posture's robot, which the others have as
            well, shape (m,) [N m/rad or N/m], [N m s/rad or N s/m].
        members: values of the parameters in which they differ by key (see `jaxact.parameters`;
            `actuator` holds names of presets), shape (n,) each; none: one member.
        engine: "mjx", "mujoco", "warp" or "auto"; None: the specification's own.
        ended: called after each rollout.

    Raises:
        UserError: postures with other joints, for values out of their bounds, and for a robot that
            cannot be simulated.
    """
    if not situations:
        raise UserError("validation: needs a posture at least")
    scenes = {name: _scene(one, name) for name, one in situations.items()}
    joints = next(iter(scenes.values())).labels
    columns = checked_members(members)
    for name, scene in scenes.items():
        if sorted(scene.labels) != sorted(joints):
            raise UserError(
                f"{name}: drives other joints than {next(iter(situations))}; postures of one "
                f"robot have the same: {', '.join(joints)}"
            )
    rows, engines = [], []
    for name, one in situations.items():
        asked = with_gains(one, scenes[name], joints, kp, kd, columns)
        asked = _engines.resolved(replace(asked, engine=engine or one.engine, devices=1))
        order = [scenes[name].labels.index(joint) for joint in joints]
        rows.append(_posture_row(asked, scenes[name], columns, order, joints, ended))
        engines.append(asked.engine)
    verdict, growth, excursion, fallen = (
        np.stack([row[place] for row in rows]) for place in range(4)
    )
    reasons, moved = (tuple(row[place] for row in rows) for place in (4, 5))
    return Validation(
        tuple(situations), joints, verdict, growth, excursion, fallen, reasons, tuple(engines),
        moved,
    )  # fmt: skip


def _scene(specification: Specification, name: str) -> Scene:
    if specification.plant is None:
        raise UserError(f"{name}: only a robot is validated; give one below [plant]")
    return robots.scene(specification.plant)


def checked_members(members: Columns) -> dict[str, np.ndarray]:
    """The members' values, shape (n,) each; a column that changes nothing where there is none.

    Raises:
        UserError: columns of different length, unknown parameters and values out of bounds.
    """
    columns = {key: np.atleast_1d(np.asarray(values)) for key, values in members.items()}
    if len({values.shape for values in columns.values()}) > 1:
        raise UserError("validation: every parameter of the members needs a value for each member")
    for key, values in columns.items():
        if key == "actuator":
            continue
        if not known(key):
            raise UserError(f"{key}: not a parameter that members can differ in")
        for value in values:
            check(key, float(value))
    return columns or {FEEDFORWARD: np.zeros(1)}


def with_gains(
    specification: Specification,
    scene: Scene,
    joints: tuple[str, ...],
    kp: np.ndarray,
    kd: np.ndarray,
    columns: Columns,
) -> Specification:
    """A specification with gains for every joint, and nothing varied but what the columns hold.

    Args:
        specification: with a plant.
        scene: its robot.
        joints: names of joints.
        kp, kd: of these joints, shape (m,).
        columns: of samples; what they hold is part of the specification, at its first value.

    Raises:
        UserError: a name that means several joints, and for gains out of their bounds.
    """
    kept: dict[str, float | str] = {
        key: value
        for key, value in specification.parameters.items()
        if key.partition("@")[0] not in (KP, KD, GAIN_SCALE) and key != "actuator"
    }
    if "actuator" in specification.parameters and "actuator" not in columns:
        kept = {"actuator": specification.parameters["actuator"], **kept}
    kept |= {key: float(values[0]) for key, values in columns.items() if key != "actuator"}
    for name, gains in ((KP, kp), (KD, kd)):
        for joint, gain in zip(joints, np.asarray(gains, float), strict=True):
            key = f"{name}@{re.escape(joint)}"
            if robots.matched(scene, key).sum() > 1:
                raise UserError(f"joint '{joint}': an actuator of another joint has the same name")
            kept[key] = check(key, float(gain))
    return replace(specification, parameters=kept, axes=(), sampling=None)


def _posture_row(
    asked: Specification,
    scene: Scene,
    columns: Columns,
    order: list[int],
    joints: tuple[str, ...],
    ended: Callable[[], None],
) -> tuple[Any, ...]:
    """Verdicts, growth rates, excursions, falls, reasons and motions of one posture.

    Joints in `order`.
    """
    samples = explicit(asked, dict(columns))
    number = len(samples)
    verdict, growth = np.zeros(number, np.int8), np.zeros(number)
    excursion, fallen = np.zeros((number, len(joints))), np.zeros(number, bool)
    reasons = [""] * number
    moved: list[tuple[Motion, ...]] = [()] * number
    # Pushed as they are, these robots need no other starts.
    for sample, one in single.each(asked, samples, starts=False):
        trajectory = one.trajectory
        assert trajectory.configuration is not None
        growth[sample] = one.results["growth_rate"]
        off = np.abs(trajectory.position - trajectory.setpoint)
        # What is not a number does not replace what came before.
        excursion[sample] = np.nanmax(off, axis=0, initial=0.0)[order]
        fallen[sample] = _posture.fallen(scene.robot, np.asarray(trajectory.configuration[-1]))
        code = Verdict(int(one.results["verdict"]))
        fallen[sample] |= code == Verdict.TOPPLES and growth[sample] < 0.0
        if code == Verdict.TOPPLES or (fallen[sample] and code != Verdict.INVALID):
            code = Verdict.UNSTABLE
        verdict[sample] = code
        amplitude = one.results["limit_cycle_amplitude"]
        reasons[sample] = _reason(code, growth[sample], bool(fallen[sample]), amplitude)
        reasons[sample] += _farthest(excursion[sample], joints)
        moved[sample] = motions(trajectory, order)
        ended()
    return verdict, growth, excursion, fallen, tuple(reasons), tuple(moved)


def _reason(verdict: Verdict, growth_rate: float, fallen: bool, amplitude: float) -> str:
    """What happened, in words."""
    if verdict == Verdict.INVALID:
        return "the simulation produced values that are not numbers"
    grows = growth_rate >= 0.0
    small = (
        f"small perturbations grow at {growth_rate:.3g} 1/s"
        if grows
        else f"small perturbations decay at {-growth_rate:.3g} 1/s"
    )
    if verdict == Verdict.STABLE:
        return f"comes to rest; {small}"
    if fallen:
        return f"falls; {small}"
    if verdict == Verdict.UNSTABLE:
        return f"motion grows; {small}"
    return f"keeps moving by +-{amplitude:.2g}; {small}"


def _farthest(excursion: np.ndarray, joints: tuple[str, ...]) -> str:
    if not np.isfinite(excursion).all():
        return ""
    worst = int(np.argmax(excursion))
    return f"; {joints[worst]} is off by up to {excursion[worst]:.2g}"
