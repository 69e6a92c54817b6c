"""`jaxact.margins` of a robot: linearised at its posture, judged as its controllers sample it."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxact.analysis.robot.margins import JointMargins, WholeMargins
from jaxact.analysis.robot.one_thread import one_thread
from jaxact.loops import conversion
from jaxact.loops.control_loop import ControlLoop
from jaxact.loops.weak_joints import tell_leaving, tell_weak
from jaxact.parameters import KD, KP
from jaxact.reportable import Reportable
from jaxact.robot_margins import whole_robot
from jaxact.robot_margins.whole_robot import WholeRobot
from jaxact.verbs import naming, notebook, robot_tables

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from jaxact.robot_margins.stiction import Stiction

# Metrics that a robot has whether it is stable or not.
_ALWAYS = {
    "stable": bool, "unstable_roots": int, "spectral_radius": float, "growth_rate": float,
    "shaking_rate": float, "toppling_rate": float, "log_gain_to_boundary": float,
}  # fmt: skip
_WHOLE = tuple(f.name for f in fields(WholeMargins))
_OF_JOINTS = tuple(f.name for f in fields(JointMargins) if f.name != "name")
_UNITS = {
    "growth_rate": "1/s", "shaking_rate": "1/s", "toppling_rate": "1/s", "delay_margin": "s",
    "phase_margin": "rad", "gain_crossover": "rad/s", "phase_crossover": "rad/s",
    "gain_reduction_frequency": "rad/s",
}  # fmt: skip


@dataclass(frozen=True, repr=False)
class RobotLoopMargins(Reportable):
    """Margins of a robot's loop, or of a batch of them; each metric is an array.

    Of all joints at once, of the batch's shape: `stable`, `growth_rate` [1/s] of the fastest motion
    (negative: it decays), `shaking_rate` and `toppling_rate`, that of the fastest which swings and
    which does not, `gain_margin`, `gain_reduction_margin`, `delay_margin` [s], `sensitivity_peak`,
    `complementary_peak`, `disk_margin`, ...; NaN where the robot is unstable. A pytree of these
    arrays.

    Attributes:
        loop: what they are of.
        metrics: by name.
        of_joints: margins of each joint with all others closed, by name, shape (..., joints).
        details: what was computed of each loop, in C order of the batch: modes, changes, curves.
    """

    loop: ControlLoop
    metrics: dict[str, np.ndarray]
    of_joints: dict[str, np.ndarray]
    details: tuple[WholeRobot, ...]

    def __dir__(self) -> list[str]:
        """The metrics, too."""
        return [*super().__dir__(), *self.metrics]

    def __getattr__(self, name: str) -> Any:
        """A metric of all joints at once by its name."""
        if name.startswith("_") or name not in (*_ALWAYS, *_WHOLE):
            raise AttributeError(f"margins of a robot have no {name!r}; {', '.join(self.metrics)}")
        return self.metrics[name]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the driven joints."""
        return self.details[0].robot.names

    @property
    def verdict(self) -> np.ndarray | str:
        """`stable`, `shakes`, `topples`, or `shakes and topples`; of the batch's shape."""
        words = [found.margins.verdict for found in self.details]
        return np.array(words, dtype=object).reshape(self.loop.shape)[()]

    @functools.cached_property
    def stiction(self) -> tuple[Stiction | None, ...]:
        """What dry friction holds that would shake once it moves, by simulation; loop by loop."""
        return tuple(found.stiction for found in self.details)

    def to_xarray(self) -> xr.Dataset:
        """All metrics as variables with units; those of joints have the dimension `joint`."""
        import xarray as xr

        samples = conversion.samples(self.loop)
        dims = samples.dims if self.loop.shape else ()
        variables: dict[str, Any] = {
            name: (dims, array, {"units": _unit(name)}) for name, array in self.metrics.items()
        }
        variables |= {
            f"joint_{name}": ((*dims, "joint"), array, {"units": _unit(name)})
            for name, array in self.of_joints.items()
        }
        coords: dict[str, Any] = {"joint": list(self.joints)}
        if self.loop.shape:
            coords |= {
                name: (place.dims, place.values, place.attributes)
                for name, place in samples.coords.items()
            }
        return xr.Dataset(variables, coords)

    def to_pandas(self) -> pd.DataFrame:
        """The margins of the joints, one joint of one loop a row."""
        found = self.to_xarray()
        own = found[[name for name in found if "joint" in found[name].dims]]
        return own.to_dataframe().reset_index()

    def to_json(self) -> str:
        """A JSON object for each loop, one a line, `stiction` in it."""
        return "\n".join(robot_tables.as_json(*row) for row in self._described(self.stiction))

    def __repr__(self) -> str:
        """The tables of the command line; of what dry friction holds once it was asked for."""
        held = self.__dict__.get("stiction", (None,) * len(self.details))
        return "\n".join(robot_tables.as_text(*row) for row in self._described(held))

    def _repr_html_(self) -> str:
        return notebook.robot_margins(self)

    def _described(
        self, held: tuple[Stiction | None, ...]
    ) -> Iterator[tuple[str, WholeRobot, Stiction | None]]:
        """What tables take of each loop."""
        labels = naming.labels(conversion.samples(self.loop)) or ("",) * len(self.details)
        return zip(labels, self.details, held, strict=True)


class _Same:
    """Details of a pytree: what tells two of them apart is which object they are."""

    def __init__(self, details: tuple[WholeRobot, ...]) -> None:
        self.details = details


def _flatten(found: RobotLoopMargins) -> tuple[tuple[Any, ...], _Same]:
    return (found.loop, found.metrics, found.of_joints), _Same(found.details)


def _unflatten(details: _Same, children: Any) -> RobotLoopMargins:
    return RobotLoopMargins(*children, details.details)


jax.tree_util.register_pytree_node(RobotLoopMargins, _flatten, _unflatten)


@one_thread()
def margins_of_robot(loop: ControlLoop, engine: str = "mujoco") -> RobotLoopMargins:
    """The margins of a robot's loops, as `jaxact.margins`.

    Args:
        loop: from `jaxact.robot`, not traced.
        engine: it is linearised in, "mujoco" or "mjx".

    Raises:
        UserError: the robot, or what is said of it, cannot be used.
        TypeError: the loop is traced.
    """
    own = conversion.linear_specification(loop, engine=engine)
    samples = conversion.samples(loop)
    tell_weak(own.plant, samples.along)
    found = tuple(whole_robot.evaluate(own, samples))
    tell_leaving(one.leaves for one in found if one.margins.stable)
    shape = loop.shape
    metrics = {
        name: np.array([getattr(one.margins, name) for one in found], kind).reshape(shape)[()]
        for name, kind in _ALWAYS.items()
    } | {name: np.array([_whole(one, name) for one in found]).reshape(shape)[()] for name in _WHOLE}
    count = len(found[0].robot.names)
    of_joints = {
        KP: np.array([one.kp for one in found]),
        KD: np.array([one.kd for one in found]),
    }
    of_joints |= {
        name: np.array([_of_each(one, name, count) for one in found]) for name in _OF_JOINTS
    }
    of_joints = {name: array.reshape((*shape, count)) for name, array in of_joints.items()}
    return RobotLoopMargins(loop, metrics, of_joints, found)


def _whole(found: WholeRobot, name: str) -> float:
    whole = found.margins.whole
    return np.nan if whole is None else float(getattr(whole, name))


def _of_each(found: WholeRobot, name: str, count: int) -> list[float]:
    joints = found.margins.joints
    return [float(getattr(joint, name)) for joint in joints] if joints else [np.nan] * count


def _unit(name: str) -> str:
    return _UNITS.get(name, "rad/s" if name.endswith("_frequency") else "1")
