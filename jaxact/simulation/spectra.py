"""Growth rates of a batch of samples, in float64 whatever the precision of the rollouts.

Most maps are maps of gains. The command of a joint is one number, -(kp q + kd v), so that the
propagation over a period is A + b (kp c + kd d)', and by the matrix determinant lemma

    det(z - A - b (kp c + kd d)') = p(z) + kp r(z) + kd s(z):

the characteristic polynomial is linear in the gains. Those at three pairs of gains, from the
simulated loop itself, give those at all others, and only their roots are left to be found for every
sample. Robots, long delay lines and sparse samples go through the loop sample by sample.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from jaxact.analysis.robot.modes import swinging
from jaxact.analysis.robot.stability import MARGINAL
from jaxact.drive.step import DriveOptions
from jaxact.engines import MASS, MUJOCO
from jaxact.loops.samples import SAMPLE, Samples
from jaxact.loops.specification import Setting, Specification
from jaxact.parameters import CONTROL_RATE, GAIN_SCALE, KD, KP, VELOCITY_FILTER, WN
from jaxact.simulation import kernel, tiles
from jaxact.simulation.growth.delayed_roots import polynomial_doubt
from jaxact.simulation.growth.rate import TOLERANCE, GrowthOptions, SlowModes, TooManyStatesError
from jaxact.simulation.kernel import Case
from jaxact.simulation.plans import Plan
from jaxact.simulation.rollout import RolloutOptions

_GAINS = (KP, KD, GAIN_SCALE)
# Fewest samples for each set of the other parameters, and most of such sets.
_FEWEST, _MOST = 16, 1024
# Pairs of gains, as multiples of usual ones: three that span all others, and one more to check.
_PAIRS = np.array([[1.0, 1.0], [0.5, 1.0], [1.0, 0.5], [0.7, 0.6]])
_STRIDE = -0.5
# How well the polynomial at the last pair must follow from the others, relative to its size.
_AGREE = 1e-9
# Slower than this nothing swings [rad/s], and faster nothing falls: a pole of 1 cm does [1/s].
_SLOWEST, _FALL = 0.1, 30.0
# Largest residual of an eigenvalue over a period that counts.
_RESIDUAL = 1e-5
_NO_ROBOT = Setting(plant=None, motion=None, push=None, keys=(), corrected=False)


@dataclass(frozen=True)
class _Sets:
    """The sets of parameters other than gains in a sweep, and their polynomials of degree n.

    Attributes:
        shape: of the sets: a size of 1 along the dimensions of the gains.
        usual: gains (kp, kd) that `_PAIRS` are multiples of.
        bases: of each set those that span it, shape (sets, 3, n).
        linear: whether they do, and rounding does not matter, shape (sets,).
    """

    shape: tuple[int, ...]
    usual: tuple[float, float]
    bases: np.ndarray
    linear: np.ndarray


@dataclass(frozen=True)
class Rates:
    """Growth rates of samples in float64 [1/s].

    Attributes:
        growth: of the fastest-growing motion, shape (batch,); of a robot 0 where it neither grows
            nor decays, beyond rounding.
        shaking: of a robot, of the fastest-growing one that swings faster than it grows or decays,
            likewise; minus the control rate where no slow one swings, and the growth rate beyond
            30 1/s, at which nothing falls; None without a robot.
    """

    growth: np.ndarray
    shaking: np.ndarray | None = None


def rates_batch(
    plan: Plan, specification: Specification, samples: Samples, numbers: np.ndarray
) -> Rates:
    """Growth rates of one batch of samples, and of robots the shaking rates."""
    with jax.enable_x64(True):
        if plan.case.engine.robot:
            return _of_robots(plan, specification, samples, numbers)
        sets = _sets(plan, specification, samples)
        if sets is None:
            return Rates(_each(plan, specification, samples, numbers))
        rates, sound = _of_gains(plan, sets, samples, numbers)
        if sound.all():
            return Rates(rates)
        return Rates(np.where(sound, rates, _each(plan, specification, samples, numbers)))


def _each(
    plan: Plan, specification: Specification, samples: Samples, numbers: np.ndarray
) -> np.ndarray:
    """Growth rates, every sample by itself."""
    case, setting = kernel.linear_part(plan.case, specification.setting)
    static = tiles.static(plan, "growth_rate", case, setting)
    found = tiles.run(*tiles.tiled(plan, samples, numbers, np.float64), **static)
    return np.asarray(found).reshape(-1)


def _of_robots(
    plan: Plan, specification: Specification, samples: Samples, numbers: np.ndarray
) -> Rates:
    """Growth and shaking rates, every robot by itself."""
    case, setting = kernel.linear_part(plan.case, specification.setting)
    # MJX's own derivatives are the same, and take as long to compile as its simulation.
    case = replace(case, engine=MUJOCO)
    static = tiles.static(plan, "slow_modes", case, setting)
    inputs: list[Any] = [*tiles.tiled(plan, samples, numbers, np.float64)]
    if plan.case.varied:
        from jaxact.simulation import changed_models  # imports MuJoCo

        moved = changed_models.moved(plan.case, specification.setting, samples.take(numbers))
        rows = plan.devices * plan.tiles, plan.tile
        inputs.append([part.reshape(*rows, *part.shape[1:]) for part in moved])
    modes = jax.tree.map(np.asarray, tiles.run(*inputs, **static))
    modes = jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), modes)
    rate = samples.take(numbers, {CONTROL_RATE})[CONTROL_RATE]
    # A joint without stiffness stays where it is: rounding alone would say whether it grows.
    growth = np.where(np.abs(modes.growth) <= MARGINAL, 0.0, modes.growth)
    return Rates(growth * rate, _shaking(modes, rate) * rate)


def _shaking(modes: SlowModes, rate: np.ndarray) -> np.ndarray:
    """Logarithm of the largest swinging root's size over a period, shape (batch,).

    The growth itself where the largest of all roots swings, -1 where no slow one does. Eigenvalues
    of a projection are those of the loop where their residual is small,

        |P V y - z V y|^2 = y* (P V)* (P V) y - |z|^2,    V* P V y = z y

    Source: Saad, "Numerical Methods for Large Eigenvalue Problems", 2nd ed., section 4.3.
    """
    sound = np.isfinite(modes.matrix).all(axis=(1, 2)) & np.isfinite(modes.growth)
    matrices = np.where(sound[:, None, None], modes.matrix, 0.0)
    roots, vectors = np.linalg.eig(matrices)
    lengths = np.einsum("lij,lik,lkj->lj", vectors.conj(), modes.products, vectors).real
    known = lengths - np.abs(roots) ** 2 < _RESIDUAL**2
    roots = roots * np.exp(np.where(sound, modes.usual, 0.0))[:, None]
    sizes = np.where(known, np.abs(roots), 0.0)
    # Rounding makes pairs of the roots at z = 1 that a free base has.
    swings = known & swinging(roots) & (np.abs(np.angle(roots)) * rate[:, None] > _SLOWEST)
    swinging_size = np.log(np.where(swings, sizes, 0.0).max(axis=1, initial=math.exp(-1.0)))
    first = np.take_along_axis(swings, sizes.argmax(axis=1)[:, None], axis=1)[:, 0]
    # The slow modes of a loop that grows so fast are lost beside the one that does.
    first |= modes.growth * rate > _FALL
    found = np.where(first, modes.growth, np.minimum(swinging_size, modes.growth))
    return np.where(sound, found, np.nan)


def _sets(plan: Plan, specification: Specification, samples: Samples) -> _Sets | None:
    """The sets of parameters whose gains alone differ; None where that is of no use."""
    if plan.case.engine.robot or SAMPLE in samples.dims:
        return None
    others = {name: array for name, array in samples.along.items() if name not in _GAINS}
    shape = np.broadcast_shapes(*(array.shape for array in others.values()))
    number = int(np.prod(shape))
    # Over several periods they are not linear in the gains.
    short = plan.case.growth.block < 8
    if number > _MOST or number * _FEWEST > len(samples) or not short:
        return None
    usual = _usual(samples, KP), _usual(samples, KD)
    rows = tuple((name, array.shape, array.tobytes()) for name, array in others.items())
    table = _polynomials(replace(plan, rates=None), specification.setting, usual, shape, rows)
    if table is None:
        return None
    bases = np.stack([table[:, 0], table[:, 1] - table[:, 0], table[:, 2] - table[:, 0]], axis=1)
    kp, kd = (_PAIRS[-1] - 1.0) / _STRIDE
    guess = bases[:, 0] + kp * bases[:, 1] + kd * bases[:, 2]
    wrong = np.abs(guess - table[:, -1]).max(axis=1)
    linear = wrong <= _AGREE * np.abs(table).max(axis=(1, 2))
    differenced = plan.case.drive.sensor.differenced
    return _Sets(shape, usual, bases, linear & _told_apart(others, shape, differenced))


def _told_apart(
    others: dict[str, np.ndarray], shape: tuple[int, ...], differenced: bool
) -> np.ndarray:
    """Whether a polynomial's coefficients in z tell slow modes apart, shape (sets,)."""
    rate = others[CONTROL_RATE]
    with np.errstate(over="ignore"):
        poles = np.minimum((others[WN] / rate) ** 2, 1.0)
    if differenced:
        poles = poles * np.minimum(others[VELOCITY_FILTER] / rate, 1.0)
    doubt = polynomial_doubt(np.broadcast_to(poles, shape)) * rate
    return np.broadcast_to(doubt <= TOLERANCE, shape).reshape(-1)


def _usual(samples: Samples, name: str) -> float:
    """A gain [N/m or N s/m] of the size that occurs in a sweep."""
    sizes = np.abs(samples.along[name])
    sizes = sizes[sizes > 0.0]
    return float(np.exp(np.log(sizes).mean())) if sizes.size else 1.0


@functools.lru_cache(maxsize=8)
def _polynomials(
    plan: Plan,
    setting: Setting,
    usual: tuple[float, float],
    shape: tuple[int, ...],
    others: tuple[tuple[str, tuple[int, ...], bytes], ...],
) -> np.ndarray | None:
    """Characteristic polynomials of every set with every pair of gains, shape (sets, pairs, n).

    Args:
        others: name, shape and values of the parameters; None is returned for loops of many states.
    """
    lead = (1,) * len(shape)
    along = {name: np.frombuffer(values).reshape(*size, 1) for name, size, values in others}
    kp, kd = (_PAIRS * usual).T.reshape(2, *lead, -1)
    along |= {KP: kp, KD: kd, GAIN_SCALE: np.ones((*lead, 1))}
    samples = Samples(along, ("set",) * len(shape) + ("pair",), (*shape, len(_PAIRS)), {})
    number = len(samples)
    few = replace(plan, tiles=-(-number // (plan.tile * plan.devices)))
    numbers = np.minimum(np.arange(few.batch), number - 1)
    case, setting = kernel.linear_part(plan.case, setting)
    static = tiles.static(plan, "transition", case, setting)
    try:
        found = np.asarray(tiles.run(*tiles.tiled(few, samples, numbers, np.float64), **static))
    except TooManyStatesError:
        return None
    found = _fed_back(found.reshape(few.batch, *found.shape[2:])[:number])
    return _characteristic(found).reshape(-1, len(_PAIRS), found.shape[-1])


def _fed_back(matrices: np.ndarray) -> np.ndarray:
    """The matrices without what no other state follows from: a clock is not a mode of the loop."""
    linked = (matrices != 0.0).any(axis=0)
    np.fill_diagonal(linked, False)
    kept = np.arange(len(linked))
    while not (used := linked[np.ix_(kept, kept)].any(axis=0)).all():
        kept = kept[used]
    return matrices[:, kept[:, None], kept]


def _characteristic(matrices: np.ndarray) -> np.ndarray:
    """Coefficients c_1 ... c_n of x^n + c_1 x^(n-1) + ... + c_n, shape (..., n).

    From the eigenvalues, which LAPACK finds after balancing the matrix: its rows have units.
    """
    sound = np.isfinite(matrices).all(axis=(-2, -1), keepdims=True)
    roots = np.linalg.eigvals(np.where(sound, matrices, 0.0))
    grown = np.zeros((*roots.shape[:-1], roots.shape[-1] + 1), complex)
    grown[..., 0] = 1.0
    for place in range(roots.shape[-1]):
        grown[..., 1:] -= roots[..., place, None] * grown[..., :-1]
    return np.where(sound[..., 0], grown[..., 1:].real, np.nan)


def _of_any(case: Case) -> Case:
    """A case with the same search for roots: what else a loop is, its polynomial tells."""
    growth = GrowthOptions(squarings=case.growth.squarings)
    return Case(MASS, DriveOptions(), RolloutOptions(0), masked=False, duration=0.0, growth=growth)


def _of_gains(
    plan: Plan, sets: _Sets, samples: Samples, numbers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Growth rates of samples, and whether their sets' polynomials are linear in the gains."""
    places = np.arange(sets.linear.size).reshape(sets.shape)
    along = {name: samples.along[name] for name in (*_GAINS, CONTROL_RATE)}
    values = replace(samples, along=along | {"place": places}).take(numbers)
    rows = plan.devices * plan.tiles, plan.tile
    own = {
        name: ((values[GAIN_SCALE] * values[name] / usual - 1.0) / _STRIDE).reshape(rows)
        for name, usual in zip((KP, KD), sets.usual, strict=True)
    }
    shared = {"bases": sets.bases[0]}
    if len(sets.bases) > 1:
        shared = {"bases": sets.bases}
        own["place"] = values["place"].reshape(rows).astype(np.int32)
    static = tiles.static(plan, "log_radius", _of_any(plan.case), _NO_ROBOT)
    found = np.asarray(tiles.run(shared, own, **static)).reshape(-1)
    return found * values[CONTROL_RATE], sets.linear[values["place"]]
