"""The tuning problem of single joints: smooth for the descent, exact rows for the polish.

The unknowns are x = (ln kp, ln kd). Cases lie side by side: different joints with the same goal, or
one joint with bounds that differ, as along a Pareto front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.parameters import KP
from jaxact.tuning.box import sobol
from jaxact.tuning.certificate import Metrics
from jaxact.tuning.goal import WORST, Goal, tail_weights
from jaxact.tuning.joint import metrics
from jaxact.tuning.joint.ensemble import PLANT, Ensemble
from jaxact.tuning.joint.metrics import Exact
from jaxact.tuning.joint.response import timed as timed_of
from jaxact.tuning.joint.spectrum import Spectrum, log_metrics, single_precision, tabulate
from jaxact.tuning.objective import Smooth, combine
from jaxact.tuning.polish import Problem, Rows

# Starts (a, b): kd = a m / lag, kp = b m / lag^2. Stable where b < a; the optima for peaks of 1.1
# to 2.5 lie between them.
STARTS = (
    (0.08, 0.0015), (0.15, 0.005), (0.25, 0.02), (0.25, 0.06),
    (0.40, 0.04), (0.40, 0.10), (0.60, 0.08), (0.60, 0.25),
)  # fmt: skip
# Between the points whose slopes make second derivatives [-].
_APART = 1e-4
# Where starts all over the plane lie, in the same units.
_ALL_OVER = np.log([[1e-3, 3e-4], [0.8, 0.6]])
# How much stiffer than what just keeps a joint upright the starts are, at least.
_HELD = 1.5


@dataclass(frozen=True)
class Case:
    """One joint, or one ensemble, with what is asked of it."""

    members: Ensemble
    goal: Goal


def time_scale(case: Case) -> np.ndarray:
    """Time that normalises gains and frequencies of each member [s], shape (n,).

    The lag; for a loop without any it is what the stiffest gains allowed make it, or the longest
    lag of the others, which limits the gains of all.
    """
    lag, stiffest = case.members.lag, case.goal.max_kp
    fastest = 0.3 * np.sqrt(case.members.mass / stiffest) if np.isfinite(stiffest) else lag.max()
    return np.where(lag > 0.0, lag, fastest)


def starts(case: Case, number: int) -> np.ndarray:
    """Default log-gains to start from, shape (number, 2): the same for all joints but for scale.

    Args:
        number: the first ones of STARTS, and between them where more are asked for.
    """
    table = np.log(np.array(STARTS))
    if number > len(table):
        from scipy.stats import qmc

        spread = qmc.Sobol(2, scramble=False).random_base2(max(number - 1, 1).bit_length())
        low, high = np.log([0.05, 1e-3]), np.log([0.8, 0.5])
        table = np.concatenate([table, low + (high - low) * spread[1:]])
    # The slowest and the lightest member limit what all get along with.
    lag, mass = time_scale(case).max(), case.members.mass.min()
    a, b = table[:number].T
    low, high = log_bounds(case.goal)[:, 0] - np.log(mass / lag**2)
    stiffer = b < low
    b = np.clip(b, low, high)
    # Stiffer than the table: with as much damping as could be stable, b < a.
    if stiffer.any():
        a = np.where(stiffer, np.linspace(low + 0.1, max(low + 1.0, 0.0), number), a)
    # On top of what keeps every member from toppling.
    toppling = max(-float(case.members.joint_stiffness.min()), 0.0)
    kp = b + np.log(mass / lag**2)
    kp = np.log(np.exp(kp) + _HELD * toppling) if toppling else kp
    return np.stack([kp, a + np.log(mass / lag)], axis=1)


def starts_all_over(case: Case, number: int, x: np.ndarray) -> np.ndarray:
    """Log-gains x and others all over what could be stable, shape (number, 2).

    Where the joint has a spring or a resonance the best gains may be far from a bare mass's.
    """
    lag, mass = time_scale(case).max(), case.members.mass.min()
    spread = _ALL_OVER[0] + (_ALL_OVER[1] - _ALL_OVER[0]) * sobol(2, number, 0)
    scale = np.log([mass / lag, mass / lag**2])
    low, high = log_bounds(case.goal)
    found = np.clip((spread + scale)[:, ::-1], low, high)
    found[0] = x
    return found


def log_bounds(goal: Goal) -> np.ndarray:
    """ln of the smallest and the largest gains allowed, shape (2, 2); +-inf where none."""
    with np.errstate(divide="ignore"):
        low, high = np.log([goal.min_kp, goal.max_kp])
    return np.array([[low, -np.inf], [high, np.inf]])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Table:
    """What the descent needs of each case; leading axes (cases, members) or (cases,).

    Attributes:
        spectrum: of every member, float32.
        log_bounds: ln of the bounds of the constraints, shape (cases, rows).
        low, high: bounds of the log-gains, shape (cases, 2).
        plant: of every member for metrics of simulated time, shape (cases, members, 6).
        tail: share of the members that counts, shape (cases,).
    """

    spectrum: Spectrum
    log_bounds: jax.Array
    low: jax.Array
    high: jax.Array
    plant: jax.Array
    tail: jax.Array


def table(cases: Sequence[Case]) -> Table:
    """Spectra and bounds of all cases, which must have as many members each."""
    cache: dict[int, Any] = {}
    for case in cases:
        if id(case.members) not in cache:
            cache[id(case.members)] = tabulate(case.members, time_scale(case))
    spectra = [cache[id(case.members)] for case in cases]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *spectra)
    bounds = np.array([[bound for *_, bound in case.goal.rows] for case in cases])
    bounds = bounds.reshape((len(cases), -1))
    ends = np.array([log_bounds(case.goal) for case in cases])
    # In float32 infinities are fine, but their gradients are not.
    ends = np.clip(ends, -80.0, 80.0)
    plant = np.stack([np.stack([getattr(c.members, p) for p in PLANT], 1) for c in cases])
    return Table(
        single_precision(stacked),
        jnp.asarray(np.log(bounds), jnp.float32),
        jnp.asarray(ends[:, 0], jnp.float32),
        jnp.asarray(ends[:, 1], jnp.float32),
        jnp.asarray(plant, jnp.float32),
        jnp.asarray([case.goal.tail for case in cases], jnp.float32),
    )


def family(goal: Goal) -> Goal:
    """The goal with numbers that only say what there is: one compiled program for all of them."""
    kept = {"max_peak": 2.0, "min_gain_margin": 2.0, "min_delay_margin": 1.0,
            "min_disk_margin": 0.5, "max_noise_gain": 1.0}  # fmt: skip
    bounds = {name: kept[name] for name in goal.active}
    risk = WORST if goal.tail == 0.0 else "mean"
    return replace(goal, **bounds, min_kp=0.0, max_kp=np.inf, risk=risk)


@dataclass(frozen=True)
class JointSurrogate:
    """The smooth problem of a goal; its numbers come with the data, so that they may vary.

    Attributes:
        goal: objective, kind of risk, and which constraints there are; see `family`.
        timed: `jaxact.tuning.joint.response.Timed` for an objective in simulated time.
    """

    goal: Goal
    timed: Any = None

    def __call__(self, x: jax.Array, data: Table, sharpness: jax.Array) -> Smooth:
        """See `jaxact.tuning.objective.Surrogate`."""
        goal, timed = self.goal, self.timed
        rows = tuple((metric, sign) for _, metric, sign, _ in goal.rows)
        names = tuple(sorted({name for name, _ in rows} | {goal.metric}))
        # Beyond a bound nothing changes any more.
        x = jnp.clip(x, data.low, data.high)
        kp, kd = jnp.exp(x[0]), jnp.exp(x[1])

        def one(spectrum: Spectrum) -> tuple[dict[str, jax.Array], jax.Array]:
            return log_metrics(spectrum, kp, kd, names, sharpness)

        found, stable = jax.vmap(one)(data.spectrum)
        if timed is not None:
            soft = jax.vmap(lambda plant: timed.smooth(kp, kd, plant, sharpness))(data.plant)
            found = found | {goal.metric: soft}
        if goal.metric == KP:
            found = found | {KP: x[:1]}  # the same for all members
        objective = goal.metric, goal.sense
        tail = None if goal.tail == 0.0 else data.tail
        return combine(found, stable, rows, data.log_bounds, objective, tail, sharpness)


def exact(cases: Sequence[Case], x: np.ndarray, timed: Any = None) -> Exact:
    """Exact metrics of every member of every case at its log-gains x, shape (cases, members)."""
    plants = {p: np.stack([getattr(c.members, p) for c in cases]) for p in PLANT}
    first = cases[0]
    extra = tuple(name for name in first.goal.wanted if timed is None or name != timed.metric)
    return metrics.evaluate(x[:, :1], x[:, 1:], plants, first.members.sampling, extra, timed)


def metrics_at(case: Case, x: np.ndarray) -> Metrics:
    """Exact metrics of all members at log-gains x, shape (2,)."""
    found = exact([case], x[None], timed_of(case.goal, [case.members]))
    return Metrics(found.stable[0], {name: log[0] for name, log in found.log.items()})


def gains(x: np.ndarray) -> tuple[float, float]:
    """kp and kd of log-gains x, shape (2,)."""
    return float(np.exp(x[0])), float(np.exp(x[1]))


def rows_of(case_goals: Sequence[Goal], x: np.ndarray, found: Exact) -> Rows:
    """Values and constraints of each case, from exact metrics of its members.

    Args:
        case_goals: of the same objective, constraints and risk; bounds may differ.
        x: log-gains, shape (cases, 2).
    """
    goal = case_goals[0]
    slope = found.gain_slope
    usable = np.all(found.stable, axis=1)
    if goal.metric == KP:
        value = x[:, :1]
        value_slope = np.broadcast_to(np.array([1.0, 0.0]), (len(x), 1, 2))
    else:
        bad, bad_slope = -goal.sense * found.log[goal.metric], -goal.sense * slope[goal.metric]
        bad, bad_slope = risk_rows(bad, bad_slope, goal.tail)
        value, value_slope = -bad, -bad_slope
    excess, excess_slope = [np.empty((len(x), 0))], [np.empty((len(x), 0, 2))]
    for place, (_, metric, sign, _) in enumerate(goal.rows):
        bound = np.log([list(g.rows)[place][3] for g in case_goals])
        over = sign * (found.log[metric] - bound[:, None])
        row, row_slope = risk_rows(over, sign * slope[metric], goal.tail)
        excess.append(row)
        excess_slope.append(row_slope)
    return Rows(value, value_slope, np.concatenate(excess, axis=1),
                np.concatenate(excess_slope, axis=1), usable)  # fmt: skip


def risk_rows(bad: np.ndarray, slope: np.ndarray, tail: float) -> tuple[np.ndarray, np.ndarray]:
    """Every member a row where the worst counts, else one row of weighted members.

    Args:
        bad: shape (cases, n);  slope: shape (cases, n, d).
    """
    if tail == 0.0:
        return bad, slope
    weights = tail_weights(np.nan_to_num(bad, nan=np.inf), tail)
    with np.errstate(invalid="ignore"):
        return (
            np.sum(np.where(weights > 0, weights * bad, 0.0), axis=1, keepdims=True),
            np.sum(np.where(weights[..., None] > 0, weights[..., None] * slope, 0.0), axis=1,
                   keepdims=True),
        )  # fmt: skip


class _Remembered:
    """Exact metrics of cases of which most stay where they are: only those that moved are new."""

    def __init__(self, cases: Sequence[Case], timed: Any) -> None:
        self._cases, self._timed = cases, timed
        self._last: tuple[np.ndarray, Exact] | None = None

    def __call__(self, x: np.ndarray) -> Exact:
        """As `exact`."""
        if self._last is None:
            found = exact(self._cases, x, self._timed)
        else:
            before, found = self._last
            moved = np.flatnonzero(np.any(x != before, axis=1))
            if len(moved):
                own = exact([self._cases[int(i)] for i in moved], x[moved], self._timed)
                found = Exact(
                    _put(found.stable, moved, own.stable),
                    {name: _put(found.log[name], moved, new) for name, new in own.log.items()},
                    {name: _put(found.slope[name], moved, new) for name, new in own.slope.items()},
                )
        self._last = x.copy(), found
        return found


def _put(rows: np.ndarray, where: np.ndarray, new: np.ndarray) -> np.ndarray:
    """A copy of the rows with others in some places."""
    rows = rows.copy()
    rows[where] = new
    return rows


def problem(cases: Sequence[Case], timed: Any = None, *, aim: bool = True) -> Problem:
    """Exact rows of cases as a function of their log-gains.

    Args:
        aim: False leaves the objective out: only the constraints are to be met.
    """
    goals = [case.goal for case in cases]
    look = _Remembered(cases, timed)

    def rows(x: np.ndarray) -> Rows:
        """As `rows_of`, with an objective that is the same everywhere where none is wanted."""
        found = rows_of(goals, x, look(x))
        if aim:
            return found
        nothing = np.zeros((len(x), 1)), np.zeros((len(x), 1, x.shape[1]))
        return Rows(*nothing, found.excess, found.excess_slope, found.usable)

    return rows


def curvature(case: Case, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Second derivatives of a case's constraints by its log-gains, weighted, shape (2, 2).

    They are central differences of the exact slopes.

    Args:
        x: log-gains, shape (2,).
        weights: of the rows of `rows_of`, shape (rows,).
    """
    points = x + _APART * np.concatenate([np.eye(2), -np.eye(2)])
    found = rows_of([case.goal] * 4, points, exact([case] * 4, points))
    slopes = weights @ np.nan_to_num(found.excess_slope, posinf=0.0, neginf=0.0)
    turned = (slopes[:2] - slopes[2:]) / (2.0 * _APART)
    return 0.5 * (turned + turned.T)
