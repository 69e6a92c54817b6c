"""Margins of many samples of a robot: together of those that differ in their gains only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxact.analysis.robot.many import Member, Motion, margins_of_many, motion
from jaxact.analysis.robot.margins import WholeMargins
from jaxact.analysis.robot.multiloop import Matrices
from jaxact.analysis.robot.shared_response import SharedResponse, shared_response
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.loops.template import Template
from jaxact.parameters import CONTROL_RATE, GAIN_SCALE, KD, KP, base
from jaxact.robot_margins import whole_robot
from jaxact.robot_margins.whole_robot import Moved, WholeRobot
from jaxact.simulation import plans
from jaxact.simulation.kernel import Case

Found = tuple[Motion, WholeMargins | None] | None
_GAINS = (KP, KD, GAIN_SCALE)
# Loops that are computed together: bounds the memory, and is what a process gets at a time.
_TOGETHER = 24


@dataclass(frozen=True)
class _Row:
    """A sample, from `jaxact.robot_margins.whole_robot.linearised`."""

    number: int
    case: Case
    template: Template
    values: dict[str, float]
    moved: Moved | None

    @property
    def family(self) -> tuple[object, ...]:
        """What samples share that differ in their gains only."""
        others = ((key, value) for key, value in self.values.items() if base(key) not in _GAINS)
        own = None if self.moved is None else tuple(part.tobytes() for part in self.moved)
        # Not a number stands for what the model has, and is not equal to itself.
        return self.case, own, *((key, repr(value)) for key, value in others)


class Families:
    """Computes what samples of a robot do, and the margins of all joints at once of those that are
    stable. What the loops of a family share is kept until the next family.
    """

    def __init__(
        self, specification: Specification, samples: Samples, reference: Mapping[str, float]
    ) -> None:
        """Read the robot.

        Args:
            specification: of the robot.
            samples: all of them.
            reference: gains by key that frequency responses are computed with, from `reference`.

        Raises:
            UserError: as `jaxact.simulation.plans.groups`.
        """
        self._specification = specification
        self._samples = samples
        self._reference = reference
        self._groups = plans.groups(specification, samples)
        self._latest: tuple[tuple[object, ...], SharedResponse] | None = None

    def evaluate(self, numbers: np.ndarray) -> list[Found]:
        """Motions and margins of some samples, by their numbers, rising, shape (n,).

        Returns:
            For each sample, in order; None of one without any gains, of which there is nothing to
            say.

        Raises:
            UserError: commands of joints with gains do not move them at all.
        """
        families: dict[tuple[object, ...], list[_Row]] = {}
        specification, samples = self._specification, self._samples
        for row in whole_robot.linearised(specification, samples, numbers, self._groups):
            own = _Row(*row)
            families.setdefault(own.family, []).append(own)
        found: dict[int, Found] = {}
        for family, rows in families.items():
            if self._latest is None or self._latest[0] != family:
                self._latest = family, _shared(specification, rows[0], self._reference)
            shared = self._latest[1]
            for first in range(0, len(rows), _TOGETHER):
                part = rows[first : first + _TOGETHER]
                found |= _of_part(shared, {row.number: _whole(specification, row) for row in part})
        return [found[int(number)] for number in numbers]


def parts(samples: Samples, numbers: np.ndarray) -> list[np.ndarray]:
    """Samples in parts to compute side by side, numbers rising in each; families stay together.

    Args:
        samples: of a robot.
        numbers: of those that are wanted, rising, shape (n,).
    """
    rows = samples.take(numbers)
    others = [np.asarray(row) for key, row in sorted(rows.items()) if base(key) not in _GAINS]
    families: dict[tuple[str, ...], list[int]] = {}
    for place, number in enumerate(numbers):
        # Not a number stands for what the model has, and is not equal to itself.
        families.setdefault(tuple(repr(row[place]) for row in others), []).append(int(number))
    found: list[list[int]] = [[]]
    for own in families.values():
        pieces = -(-len(own) // _TOGETHER)
        for piece in np.array_split(np.array(own), pieces):
            if len(found[-1]) + len(piece) > _TOGETHER:
                found.append([])
            found[-1] += piece.tolist()
    return [np.sort(np.array(part)) for part in found if part]


def _whole(specification: Specification, row: _Row) -> WholeRobot:
    return whole_robot.one(row.case, specification, row.template, row.values, row.moved)


def _of_part(shared: SharedResponse, wholes: dict[int, WholeRobot]) -> dict[int, Found]:
    found: dict[int, Found] = {}
    together: dict[int, Member] = {}
    for number, whole in wholes.items():
        if not whole.kp.any() and not whole.kd.any():
            found[number] = None
        elif shared.holds(whole.robot.matrices, whole.kp, whole.kd):
            own = replace(whole.robot, later_by=shared.later_by(whole.robot.matrices[2]))
            together[number] = Member(own, whole.kp, whole.kd)
        else:  # its drives have more than two gains
            found[number] = _alone(whole), whole.margins.whole
    members = margins_of_many(shared, list(together.values()))
    found |= dict(zip(together, members, strict=True))
    return {number: _where(wholes[number], one) for number, one in found.items()}


def _where(whole: WholeRobot, found: Found) -> Found:
    """The same of a stable loop, with why the robot does not rest where it is linearised."""
    if found is None or found[0].unstable_roots:
        return found
    return replace(found[0], leaves=whole.leaves), found[1]


def _alone(whole: WholeRobot) -> Motion:
    return motion(np.linalg.eigvals(whole.robot.matrices[0]), whole.robot.period)


def _shared(
    specification: Specification, row: _Row, reference: Mapping[str, float]
) -> SharedResponse:
    """What the loops of a family share: its matrices with two settings of the gains."""

    def with_gains(**gains: float):
        own = {key: gains.get(base(key), value) for key, value in row.values.items()}
        return whole_robot.computing(row.case, specification, own, row.moved)

    with_one = with_gains(kp=1.0, kd=0.0, gain_scale=1.0)
    one, of_one = _evaluated(with_one(0.0))
    other, of_other = _evaluated(with_gains(kp=0.0, kd=1.0, gain_scale=1.0)(0.0))
    values = {**row.values, **reference}
    _, _, kp, kd, _ = whole_robot.computing(row.case, specification, values, row.moved)(0.0)
    gains = np.array([of_one, of_other])
    period = 1.0 / row.values[CONTROL_RATE]

    def delayed(extra: float) -> tuple[np.ndarray, np.ndarray]:
        (M, N, C), _ = _evaluated(with_one(extra))
        return M - N @ C, N

    return shared_response(one, other, gains, np.array([kp, kd]), period, delayed)


def _evaluated(computed: Any) -> tuple[Matrices, np.ndarray]:
    """M, N, C, and kp and kd of the joints, shape (2, m)."""
    found, _, kp, kd, _ = computed
    return (found.M, found.N, found.C), np.array([kp, kd])


def reference(samples: Samples) -> dict[str, float]:
    """Gains in the middle of all samples, by key.

    Args:
        samples: all of a sweep's.
    """
    gains = {key: along for key, along in samples.along.items() if base(key) in _GAINS}
    return {key: float(np.median(along)) for key, along in gains.items()}
