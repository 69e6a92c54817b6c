"""`jaxact.margins`: all stability margins of a loop, exact, batched and differentiable."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.analysis.joint.margins import Margins
from jaxact.analysis.joint.margins import margins as _continuous_margins
from jaxact.analysis.joint.roots import collocation_matrices, rightmost_root
from jaxact.analysis.sampled.margins import SampledMargins
from jaxact.analysis.sampled.margins import sampled_margins as _sampled_margins
from jaxact.analysis.sampled.period_map import SampledLoop, delay_steps, one_period_matrix
from jaxact.compilation import filling
from jaxact.compilation.programs import Program
from jaxact.engines import LINEARISING as ENGINES
from jaxact.errors import UserError, nearest, shown
from jaxact.loops import conversion
from jaxact.loops.control_loop import ControlLoop, demand, is_traced
from jaxact.parameters import CONTROL_RATE, GAIN_SCALE, KP, LINEAR
from jaxact.reportable import Reportable
from jaxact.verbs import margin_tables, notebook

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from jaxact.verbs.margins_of_robot import RobotLoopMargins

# Numbers of loops and delays in control periods are rounded up to multiples of these: a program
# that is kept then serves the next call too, and computing takes far less than compiling.
_FEW, _MANY = 16, 64
_STEPS = 16
_METRICS = {f.name for kind in (Margins, SampledMargins) for f in fields(kind)}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, repr=False)
class LoopMargins(Reportable):
    """Margins of a joint's loops; each metric is an attribute, an array of the batch's shape.

    `stable`, `unstable_roots`, `gain_margin`, `phase_margin` [rad], `delay_margin` [s],
    `sensitivity_peak`, `disk_margin`, ...: all of `jaxact.analysis.joint.margins.Margins`, or of
    the sampled loop those of `jaxact.analysis.sampled.margins.SampledMargins`; `growth_rate`, in
    tables `spectral_abscissa`. Phase margins are in rad as attributes, and in degrees wherever they
    are written: in what is printed, `to_json`, `to_xarray` (see its units) and `to_pandas`. NaN
    where the loop is unstable, and the slope of such a margin is 0: `log_gain_to_boundary` is
    negative there, and its slope leads back. A pytree of arrays.

    Attributes:
        loop: what they are of.
        metrics: the margins as they are computed.
    """

    loop: ControlLoop
    metrics: Margins | SampledMargins

    def __dir__(self) -> list[str]:
        """The metrics, too."""
        return [*super().__dir__(), *margin_tables.NAMES]

    def __getattr__(self, name: str) -> Any:
        """A metric by its name."""
        if name == margin_tables.ABSCISSA:  # as tables and files call it
            return self.growth_rate
        if name not in _METRICS:
            raise AttributeError(f"margins have no {name!r}; {', '.join(margin_tables.NAMES)}")
        if not hasattr(self.metrics, name):
            raise AttributeError(f"{name!r} is of the sampled loop; give sampled=True")
        return getattr(self.metrics, name)

    @property
    def sampled(self) -> bool:
        """Whether they are of the sampled loop."""
        return isinstance(self.metrics, SampledMargins)

    @property
    def growth_rate(self) -> np.ndarray:
        """Exponential rate of a small perturbation [1/s], negative: stable; of the batch's shape.

        In continuous time the real part of the rightmost root, of the sampled loop the logarithm
        of the spectral radius over the control period.
        """
        return self.rows["spectral_abscissa"].reshape(self.loop.shape)

    @functools.cached_property
    def rows(self) -> dict[str, np.ndarray]:
        """All metrics by name, shape (n,) each; see `of_values`."""
        return of_values(_flat(self.loop), self.loop.kind.velocity if self.sampled else None)

    @property
    def written(self) -> dict[str, np.ndarray]:
        """`rows` as tables and files have them, see `jaxact.verbs.margin_tables.of_factors`."""
        if self.sampled:
            return self.rows
        return dict(margin_tables.of_factors(_flat(self.loop), self.rows))

    @property
    def found(self) -> dict[str, dict[str, np.ndarray]]:
        """`written` by the prefix of their names, as `jaxact.verbs.margin_tables` takes them."""
        return {"sampled_" if self.sampled else "": self.written}

    def to_json(self) -> str:
        """A JSON object for each loop, one a line; null where a metric means nothing."""
        return margin_tables.json_lines(self.loop, self.found)

    def to_xarray(self) -> xr.Dataset:
        """All metrics as variables with units, over the batch's dimensions."""
        return margin_tables.dataset(self.loop, self.written)

    def to_pandas(self) -> pd.DataFrame:
        """All metrics, one loop a row, beside what tells the loops apart."""
        return _frame(self.to_xarray(), self.loop)

    def __repr__(self) -> str:
        """The table of the command line."""
        if is_traced(self.loop) or any(isinstance(leaf, jax.core.Tracer) for leaf in
                                       jax.tree.leaves(self.metrics)):  # fmt: skip
            return f"<margins of {self.loop!r}>"
        return margin_tables.text(self.loop, self.found)

    def _repr_html_(self) -> str:
        return notebook.margins(self, sampled=self.sampled)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, repr=False)
class BothMargins(Reportable):
    """Margins in continuous time and of the sampled loop, side by side; a pytree of arrays.

    Attributes:
        continuous, sampled: as `LoopMargins`.
    """

    continuous: LoopMargins
    sampled: LoopMargins

    def __getattr__(self, name: str) -> Any:
        """Nothing: a metric is of one of the two."""
        if name in (*_METRICS, margin_tables.ABSCISSA, "growth_rate", "metrics", "rows"):
            raise AttributeError(
                f"{name!r} is of one of the two: .continuous.{name} or .sampled.{name}"
            )
        raise AttributeError(f"margins have no {name!r}; .continuous and .sampled have them")

    @property
    def loop(self) -> ControlLoop:
        """What they are of."""
        return self.continuous.loop

    @property
    def found(self) -> dict[str, dict[str, np.ndarray]]:
        """Metrics by the prefix of their names, as `jaxact.verbs.margin_tables` takes them."""
        return self.continuous.found | self.sampled.found

    def to_json(self) -> str:
        """A JSON object for each loop, one a line, the sampled loop's metrics in it."""
        return margin_tables.json_lines(self.loop, self.found)

    def to_xarray(self) -> xr.Dataset:
        """All metrics as variables with units, those of the sampled loop as `sampled_...`."""
        sampled = self.sampled.to_xarray()
        return self.continuous.to_xarray().assign(
            {f"sampled_{name}": each for name, each in sampled.data_vars.items()}
        )

    def to_pandas(self) -> pd.DataFrame:
        """All metrics, one loop a row, beside what tells the loops apart."""
        return _frame(self.to_xarray(), self.loop)

    def __repr__(self) -> str:
        """The table of the command line."""
        return margin_tables.text(self.loop, self.found)

    def _repr_html_(self) -> str:
        return notebook.margins(self, sampled=True)


def _frame(found: xr.Dataset, loop: ControlLoop) -> pd.DataFrame:
    """One loop a row."""
    return (found if loop.shape else found.expand_dims("loop")).to_dataframe().reset_index()


def margins(
    loop: ControlLoop, *, sampled: bool | str = False, max_delay_steps: int | None = None,
    engine: str = "mujoco",
) -> LoopMargins | BothMargins | RobotLoopMargins:  # fmt: skip
    """All stability margins of a loop or a batch of loops.

        jaxact.margins(jaxact.joint(actuator="starleth", delay=[0, 1e-3, 5e-3])).delay_margin

    Exact for any delay. Computed in float64 whatever JAX's own precision is; where the caller
    traces (jit, vmap, grad) in the caller's precision, and differentiable by every parameter. What
    is traced cannot be refused: where it is out of its bounds nothing is known, all metrics are
    NaN, `stable` is False and `unstable_roots` -1.

    Args:
        loop: from `jaxact.joint` or `jaxact.robot`. A robot is linearised at its posture and judged
            as its controllers sample it.
        sampled: of a joint: False for the loop in continuous time, whatever its `control_rate`;
            True for the loop as its controller samples it at that, which has less margin; "both"
            for both side by side.
        max_delay_steps: most whole control periods of delay; needed only where the delay or the
            control rate of a sampled loop is traced.
        engine: of a robot, "mujoco" linearises C MuJoCo by differences, "mjx" differentiates MJX.

    Returns:
        The margins, of a joint a `LoopMargins`, of the loop's shape, of a robot a
        `RobotLoopMargins`; printed, they are the command line's table. Each metric is an attribute
        (`delay_margin` [s], `phase_margin` [rad], `gain_margin`, `sensitivity_peak`, `disk_margin`,
        ...; `dir` lists them). NaN where a loop is unstable, and its derivatives
        0 there; `stable` tells.

    Raises:
        UserError: what is not a loop, parameters or arguments that do not fit each other; of a
            robot also what its model lacks.
        TypeError: a traced delay of a sampled loop without `max_delay_steps`, or a traced robot.
    """
    demand(loop)
    if sampled not in (False, True, "both"):
        raise UserError(f"sampled = {sampled!r}; allowed: False, True, 'both'")
    _check_arguments(max_delay_steps, engine, robot=loop.kind.plant is not None)
    if loop.kind.plant is not None:
        if sampled == "both":
            raise UserError("sampled = 'both' is of a joint; a robot's margins are sampled")
        from jaxact.verbs import margins_of_robot

        return margins_of_robot.margins_of_robot(loop, engine)
    if sampled == "both":
        return BothMargins(_one(loop, False, None), _one(loop, True, max_delay_steps))
    return _one(loop, bool(sampled), max_delay_steps)


def _check_arguments(steps: int | None, engine: str, *, robot: bool) -> None:
    """Raise UserError for a number of steps that is none, or an engine of other margins."""
    whole = isinstance(steps, int | np.integer) and not isinstance(steps, bool)
    if steps is not None and not (whole and steps >= 0):
        raise UserError(f"`max_delay_steps` = {shown(steps)}: give a whole number from 0")
    if engine not in ENGINES:
        raise UserError(f"`engine` = {shown(engine)}; {nearest(engine, ENGINES)}")
    if not robot and engine != ENGINES[0]:
        raise UserError(f"`engine` = {shown(engine)}: is for robots; a joint's margins are exact")


def _one(loop: ControlLoop, sampled: bool, steps: int | None) -> LoopMargins:
    if is_traced(loop):
        return LoopMargins(loop, _traced(loop, sampled, steps))
    conversion.linear_specification(loop)  # what does not fit is said here
    kind = SampledMargins if sampled else Margins
    rows = _rows(_flat(loop), loop.kind.velocity if sampled else None)
    metrics = {f.name: rows[f.name].reshape(loop.shape)[()] for f in fields(kind)}
    found = LoopMargins(loop, kind(**metrics))
    found.__dict__["rows"] = _in_degrees(rows)  # what it would compute again
    return found


def _traced(loop: ControlLoop, sampled: bool, steps: int | None) -> Margins | SampledMargins:
    values = loop.broadcast().parameters
    known = conversion.within_bounds(values, (*LINEAR, GAIN_SCALE, CONTROL_RATE))
    if not sampled:
        return _known(conversion.continuous(values), known, of=_continuous_margins)
    if steps is None:
        delay, rate = conversion.total_delay(values), values[CONTROL_RATE]
        if any(isinstance(value, jax.core.Tracer) for value in (delay, rate)):
            raise TypeError(
                "the delay or the control rate of a sampled loop is traced: give max_delay_steps, "
                "the most whole control periods that the delay may have"
            )
        steps = delay_steps(np.asarray(delay), 1.0 / np.asarray(rate))
    loops = conversion.sampled(values, loop.kind.velocity)
    return _known(loops, known, of=_sampled_margins, max_delay_steps=steps)


# Compiled as a whole: what the caller maps or differentiates without compiling it would be compiled
# operation by operation, which takes several times as long.
@partial(jax.jit, static_argnames=("of", "max_delay_steps"))
def _known(loop: Any, known: jax.Array, *, of: Callable, **static: int) -> Any:
    """Margins where the parameters are within their bounds, NaN elsewhere."""
    found = of(loop, **static)

    def if_known(field: Any) -> jax.Array:
        value = getattr(found, field.name)
        other = -1 if field.name == "unstable_roots" else False if value.dtype == bool else jnp.nan
        return jnp.where(known, value, other)

    return type(found)(**{field.name: if_known(field) for field in fields(found)})


def of_values(values: Mapping[str, np.ndarray], velocity: str | None) -> dict[str, np.ndarray]:
    """All metrics of loops by name, phase margins in degrees, in float64; shape (n,) each.

    With `spectral_abscissa` [1/s]: the real part of the rightmost root, or log(spectral radius) /
    T.

    Args:
        values: every parameter of every loop by its short name, shape (n,) each.
        velocity: of the sampled loops, "sampled" or "differenced"; None for continuous time.
    """
    return _in_degrees(_rows(values, velocity))


def _in_degrees(rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return rows | {"phase_margin": np.degrees(rows["phase_margin"])}


def _rows(values: Mapping[str, np.ndarray], velocity: str | None) -> dict[str, np.ndarray]:
    """As `of_values`, phase margins in radians."""
    number = len(values[KP])
    with jax.enable_x64(True):
        if velocity is None:
            found, root = _continuous(values)
            return _arrays(found, number) | {"spectral_abscissa": np.asarray(root).real[:number]}
        arrays = _arrays(_sampled(values, velocity), number)
    with np.errstate(divide="ignore"):
        rate = np.log(arrays["spectral_radius"]) * values[CONTROL_RATE]
    return arrays | {"spectral_abscissa": rate}


def _flat(loop: ControlLoop) -> dict[str, np.ndarray]:
    """Every parameter of every loop, shape (n,) each."""
    shape = loop.shape
    return {
        name: np.broadcast_to(np.asarray(value, float), shape).reshape(-1)
        for name, value in loop.parameters.items()
    }


def _continuous(values: Mapping[str, np.ndarray]) -> tuple[Margins, jax.Array]:
    """Margins and rightmost roots of loops and some more; to be called where float64 is on."""
    loops = conversion.continuous(_filled_up(values))
    found, matrices = _with_matrices(loops)
    # NumPy's LAPACK, which is there; JAX's would import SciPy's.
    return found, _roots(loops, np.linalg.eigvals(np.nan_to_num(matrices)).astype(complex))


def _sampled(values: Mapping[str, np.ndarray], velocity: str) -> SampledMargins:
    """Margins of sampled loops and perhaps some more; to be called where float64 is on."""
    steps = delay_steps(conversion.total_delay(values), 1.0 / values[CONTROL_RATE])
    # Long delays take long to compute, so that one loop is not to wait for others.
    filled = _filled_up(values) if steps <= _STEPS else values
    loops, steps = conversion.sampled(filled, velocity), _rounded_up(steps, _STEPS)
    plain = jax.tree.map(np.asarray, loops)  # JAX would compile each slice
    size = min(_MANY, len(filled[KP]))
    roots = filling.in_chunks(partial(_period_roots, steps=steps), plain, size)
    return _with_steps(loops, roots, steps=steps)


def _period_roots(loop: SampledLoop, *, steps: int) -> np.ndarray:
    """Roots of sampled loops, shape (k, n); by NumPy's LAPACK as in `_continuous`."""
    matrices = np.asarray(_period_matrices(loop, steps=steps))
    fits = np.isfinite(matrices).all(axis=(1, 2))
    roots = np.linalg.eigvals(np.where(fits[:, None, None], matrices, 0.0))
    return np.where(fits[:, None], roots, np.nan).astype(complex).T


def _filled_up(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Parameters of the loops, the last of which is repeated up to a round number of loops."""
    number = len(values[KP])
    size = _rounded_up(number, _FEW if number <= _FEW else _MANY)
    return filling.filled(dict(values), size)


def _rounded_up(number: int, unit: int) -> int:
    """To a multiple of the unit, which is at least 1 unit."""
    return unit * max(1, -(-number // unit))


def _arrays(found: Any, number: int) -> dict[str, np.ndarray]:
    """The metrics of the first loops, by name; shape (number,) each."""
    return {one.name: np.asarray(getattr(found, one.name))[:number] for one in fields(found)}


@Program
def _with_matrices(loop: Any) -> tuple[Margins, jax.Array]:
    return _continuous_margins(loop), collocation_matrices(loop)


@Program
def _roots(loop: Any, approximate: jax.Array) -> jax.Array:
    return rightmost_root(loop, approximate)


@Program
def _period_matrices(loop: Any, *, steps: int) -> jax.Array:
    return jax.vmap(partial(one_period_matrix, max_delay_steps=steps))(loop)


@Program
def _with_steps(loop: Any, roots: jax.Array, *, steps: int) -> SampledMargins:
    return _sampled_margins(loop, max_delay_steps=steps, roots=roots)
