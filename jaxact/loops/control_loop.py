"""The loop: a plant under its drives, by the names that everybody knows; one, or a batch of them.

    loop = joint(mass=0.7, kp=400, kd=20, actuator="starleth", delay=[0, 1e-3, 5e-3])
    loop.replace(kp=500)    # the same loop with other gains
    loop[0]                 # one of the batch

Every number is a parameter of `jaxact.parameters`, a scalar or an array; arrays broadcast against
each other. A loop is a pytree of its numbers: it can be traced, mapped and differentiated.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact.errors import UserError
from jaxact.loops import anew
from jaxact.loops.checks import OF_VELOCITY, check_velocity
from jaxact.loops.given import check_step, names_of, read
from jaxact.loops.reading import TABLE_READERS
from jaxact.loops.specification import Motion, Plant, Push, Specification
from jaxact.parameters import (
    INERTIA,
    KD,
    KP,
    MASS,
    PARAMETERS,
    base,
    canonical,
    of,
)

# Values of an array that a `repr` shows.
_SHOWN = 5


@dataclass(frozen=True)
class Kind:
    """The parts of a loop that are not numbers; static where JAX traces.

    Attributes:
        plant: the robot, None for a single joint.
        velocity: that the controller sees, "sampled" by a sensor or the "differenced" position.
        physics_step: [s], None for the engine's own.
        integrator_correction: take back MuJoCo's half step of lead, see `Specification`.
        motion: of a robot's setpoint, None for a step.
        push: on a robot, None for none.
        unit: of a single joint's position, "m" or "rad"; None: m, or what a robot's joints have.
        names: of the loops of a batch, in C order; () where they are named by what varies.
    """

    plant: Plant | None = None
    velocity: str = "sampled"
    physics_step: float | None = None
    integrator_correction: bool = False
    motion: Motion | None = None
    push: Push | None = None
    unit: str | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Take tables as a specification has them, and names in any list."""
        check_step(self.physics_step)
        object.__setattr__(self, "names", names_of(self.names))
        for name in ("motion", "push"):
            table: Any = getattr(self, name)
            if table is not None and not dataclasses.is_dataclass(table):
                object.__setattr__(self, name, TABLE_READERS[name](table, Path()))

    @property
    def specified(self) -> dict[str, Any]:
        """Those of its parts that a specification has, by name."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)[:-1]}


@dataclass(frozen=True, repr=False, eq=False)
class ControlLoop:
    """A closed control loop, or a batch of them; made by `jaxact.joint` and `jaxact.robot`.

    Every parameter of the table is an attribute, by its short or its long name: `loop.kp` or
    `loop.stiffness` [N/m, of a rotary joint N m/rad].

    Attributes:
        values: the parameters that were given, by short name, of a robot also of some joints
            (`kp@.*_knee`); numbers, or arrays that broadcast to `shape`.
        kind: its parts that are not numbers.
    """

    values: dict[str, Any]
    kind: Kind = field(default_factory=Kind)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch, () of a single loop."""
        return np.broadcast_shapes(*(np.shape(value) for value in self.values.values()))

    @property
    def parameters(self) -> dict[str, Any]:
        """Every parameter by its short name; NaN where a robot's model has a say."""
        return dict(Specification(plant=self.kind.plant).nominal) | self.values

    def replace(self, **changes: Any) -> ControlLoop:
        """The same loop with other parameters, or of another kind.

        What is given counts, whatever else the loop has of the same parameters: of a robot, a
        number for all joints before those that some had, and of patterns the newest first.

        Args:
            changes: as for `jaxact.joint`; of a robot also those of `jaxact.robot`.

        Raises:
            UserError: as there.
        """
        if INERTIA in changes and self.kind.plant is None:
            changes["unit"] = rotary(changes, changes.get("unit"))
        own = {f.name: changes.pop(f.name) for f in dataclasses.fields(Kind) if f.name in changes}
        kind = dataclasses.replace(self.kind, **own)
        if kind.plant is not None:
            names = [f.name for f in dataclasses.fields(Plant) if f.name in changes]
            mounted = {name: changes.pop(name) for name in names}
            kind = dataclasses.replace(kind, plant=dataclasses.replace(kind.plant, **mounted))
        given = read(changes, robot=kind.plant is not None, unit=kind.unit)
        return made(anew.over(self.values, given), kind)

    def named(self, *names: str) -> ControlLoop:
        """The same loops under these names, one for each, in C order of the batch."""
        return made(self.values, dataclasses.replace(self.kind, names=names))

    def broadcast(self) -> ControlLoop:
        """The same batch with every value an array of the batch's shape, as `jax.vmap` wants it."""
        import jax.numpy as jnp

        shape = self.shape
        given = {  # what JAX does not have yet it would round to its own precision
            name: (jnp if isinstance(value, jax.Array) else np).broadcast_to(value, shape)
            for name, value in self.values.items()
        }
        return dataclasses.replace(self, values=given)

    def __getitem__(self, index: Any) -> ControlLoop:
        """Some loops of the batch, as indexing an array of its shape gives them."""
        shape = self.shape
        if not shape:
            raise IndexError("a single loop has no parts; give a parameter several values")

        def part(value: Any) -> Any:
            if isinstance(value, jax.core.Tracer | jax.Array):
                import jax.numpy as jnp

                return jnp.broadcast_to(value, shape)[index]
            return np.broadcast_to(value, shape)[index]

        picked = {name: part(value) if np.ndim(value) else value for name, value in
                  self.values.items()}  # fmt: skip
        kind = self.kind
        if kind.names:
            names = np.array(kind.names, dtype=object).reshape(shape)[index]
            kind = dataclasses.replace(kind, names=tuple(np.ravel(names).tolist()))
        return dataclasses.replace(self, values=picked, kind=kind)

    def __eq__(self, other: object) -> bool:
        """Whether the other is a loop of the same kind with the same values; traced, itself."""
        if not isinstance(other, ControlLoop):
            return NotImplemented
        if is_traced(self) or is_traced(other):
            return self is other
        own, others = self.values, other.values
        return self.kind == other.kind and own.keys() == others.keys() and all(
            np.array_equal(value, others[name]) for name, value in own.items()
        )  # fmt: skip

    # Arrays have no hash.
    __hash__ = None  # type: ignore[assignment]

    def __len__(self) -> int:
        """Length of the batch along its first axis."""
        if not self.shape:
            raise TypeError("a single loop has no length")
        return self.shape[0]

    def __iter__(self) -> Iterator[ControlLoop]:
        """The loops of the batch along its first axis."""
        return (self[number] for number in range(len(self)))

    def __getattr__(self, name: str) -> Any:
        """A parameter by its short or long name."""
        short = canonical(name)
        if name.startswith("_") or short not in PARAMETERS:
            raise AttributeError(f"a loop has no {name!r}; parameters: {', '.join(PARAMETERS)}")
        if short in (KP, KD) and self.kind.plant is not None and short not in self.values:
            raise AttributeError(
                f"{name}: not one number for all joints of this robot, but by pattern, or as its"
                f' model has it: jaxact.export(loop, "toml").joints.{short} has each joint\'s'
            )
        return self.parameters[short]

    def __repr__(self) -> str:
        """`joint: mass 0.7 kg, kp 400 N/m, ...; 3 loops`."""
        plant = self.kind.plant
        # A robot's joints may slide or turn, so that gains have no one unit.
        units = plant is None
        unit = self.kind.unit
        parts = [_described(name, value, unit, units=units) for name, value in self.values.items()]
        parts += [f"velocity {self.kind.velocity}"] * (self.kind.velocity != "sampled")
        own = "rotary joint" if unit == "rad" else "joint"
        head = own if plant is None else _mounted(plant)
        number = math.prod(self.shape)
        several = f"; {number:,} loops of shape {self.shape}" if self.shape else ""
        return f"<{head}: {', '.join(parts) or 'all parameters at their defaults'}{several}>"


_VALUES = jax.tree_util.GetAttrKey("values")


def _flat(loop: ControlLoop) -> tuple[tuple[tuple[Any, Any]], tuple[Kind, tuple[str, ...]]]:
    """JAX sorts the keys of a dictionary; those for some joints count in their order."""
    patterns = tuple(key for key in loop.values if "@" in key)
    return ((_VALUES, loop.values),), (loop.kind, patterns)


def _unflat(kept: tuple[Kind, tuple[str, ...]], leaves: tuple[Any]) -> ControlLoop:
    kind, patterns = kept
    (values,) = leaves
    if isinstance(values, dict):  # JAX may put something else in its place
        last = {key: values[key] for key in patterns if key in values}
        values = {key: value for key, value in values.items() if key not in last} | last
    return ControlLoop(values, kind)


jax.tree_util.register_pytree_with_keys(ControlLoop, _flat, _unflat)


def made(values: dict[str, Any], kind: Kind) -> ControlLoop:
    """A loop whose values fit each other.

    Args:
        values: from `read`.
        kind: of the loop.

    Raises:
        UserError: the shapes of the values do not broadcast, or the velocity of this kind has no
            such sensor or filter.
    """
    loop = ControlLoop(values, kind)
    try:
        number = math.prod(loop.shape)
    except ValueError:
        shapes = ", ".join(f"{name} {np.shape(v)}" for name, v in values.items() if np.ndim(v))
        raise UserError(f"the shapes of the values do not broadcast: {shapes}") from None
    if kind.names and len(kind.names) != number:
        raise UserError(f"`names`: {len(kind.names)} names for {number:,} loops; give one for each")
    for name, value in values.items():
        if base(name) in OF_VELOCITY and not isinstance(value, jax.core.Tracer):
            own = np.ravel(value).tolist()
            check_velocity(name, own, f"`{name}`", differenced=kind.velocity == "differenced")
    return loop


def demand(loop: Any, name: str = "loop") -> None:
    """Raise UserError for what is not a loop, or a batch of none.

    Args:
        loop: what was given for one.
        name: of the argument.
    """
    if isinstance(loop, ControlLoop):
        if 0 in loop.shape:
            raise UserError(f"{name}: is a batch without loops, of shape {loop.shape}; give some")
        return
    several = isinstance(loop, list | tuple) and all(isinstance(one, ControlLoop) for one in loop)
    raise UserError(
        f"{name}: several loops are one with several values, e.g. jaxact.joint(kp=[100, 400])"
        if several and loop
        else f"{name}: a value of type {type(loop).__name__} is not a loop; give one from "
        "jaxact.joint(...), jaxact.robot(...) or an identification's .loop"
    )


def is_traced(loop: ControlLoop) -> bool:
    """Whether JAX traces one of the loop's values."""
    return any(isinstance(value, jax.core.Tracer) for value in loop.values.values())


def rotary(given: Iterable[str], unit: str | None) -> str:
    """The unit of a joint that an inertia was given of, "rad".

    Args:
        given: names of parameters, `inertia` among them.
        unit: that was given, None for none.

    Raises:
        UserError: a mass was given, too, or the joint slides.
    """
    if unit == "m":
        raise UserError('inertia: is that of a rotary joint; drop unit = "m", or give mass')
    if any(name != INERTIA and canonical(name) == MASS for name in given):
        raise UserError("inertia: mass says the same of a joint that slides; give one of the two")
    return "rad"


def _described(name: str, value: Any, own_unit: str | None, *, units: bool) -> str:
    parameter = of(name, own_unit)
    unit = parameter.unit if units or parameter.unit in ("s", "Hz", "rad/s") else "1"
    name = INERTIA if own_unit == "rad" and name == MASS else name
    if isinstance(value, jax.core.Tracer):
        shown_value = "traced"
    elif not np.ndim(value):
        shown_value = f"{float(value):g}"
    else:
        flat = np.asarray(value, float).ravel()
        rest = ", ..." if flat.size > _SHOWN else ""
        shown_value = f"[{', '.join(f'{number:g}' for number in flat[:_SHOWN])}{rest}]"
    return f"{name} {shown_value}{'' if unit == '1' else f' {unit}'}"


def _mounted(plant: Plant) -> str:
    words = [f"robot {plant.model.name}"]
    words += [f"keyframe {plant.keyframe}"] if plant.keyframe else []
    words += [f"base {plant.base}"] if plant.base != "free" else []
    return ", ".join(words)
