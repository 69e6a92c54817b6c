"""Torque-speed lines: `stall_force` and `no_load_speed` make one together; half of one is a slip.

Half a line would be ignored silently, so it is refused: of a loop, of each loop of a batch, of each
joint.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxact.errors import UserError
from jaxact.loops.axes import Axis
from jaxact.loops.specification import Setting, Specification
from jaxact.parameters import NO_LOAD_SPEED, STALL_FORCE, base

LINE = (STALL_FORCE, NO_LOAD_SPEED)
_MOST_NAMES = 4


def check(line: Iterable[Any], joints: Sequence[str] = ()) -> None:
    """Raise UserError where a loop, or a joint of it, has half a torque-speed line.

    Args:
        line: stall force and no-load speed, numbers or arrays that broadcast, inf for none; of
            joints along the last axis, of loops along all others.
        joints: their names; () where no axis is of joints.
    """
    force, speed = (np.isfinite(np.atleast_1d(np.asarray(values))) for values in line)
    rank = max(force.ndim, speed.ndim)
    force, speed = (one.reshape((1,) * (rank - one.ndim) + one.shape) for one in (force, speed))
    missing = []
    for name, other, own in ((NO_LOAD_SPEED, force, speed), (STALL_FORCE, speed, force)):
        lacks = _without(other, own, rank - bool(joints))
        if joints and lacks.any():
            lacking = np.flatnonzero(np.broadcast_to(lacks, len(joints))).tolist()
            missing.append(f"{name} of {_listed([joints[i] for i in lacking])}")
        elif lacks.any():
            always = other.all() and not own.any()
            missing.append(name if always else f"{name} of some loops")
    if missing:
        raise UserError(
            f"{', '.join(missing)}: a torque-speed line needs stall_force and no_load_speed, both"
            " finite; give both or none"
        )


def check_specification(specification: Specification, axes: Mapping[str, Axis]) -> None:
    """Raise UserError for half a line that some loop has however values are paired.

    What depends on the pairs of a batch, or on the joints that a pattern matches, is for
    `check_samples`.
    """
    if any("@" in key and base(key) in LINE for key in (*specification.parameters, *axes)):
        return
    ends = [axes[n].ends if n in axes else (specification.nominal[n],) * 2 for n in LINE]
    force, speed = (np.array(one, float) for one in ends)
    if set(np.isfinite(force)) != set(np.isfinite(speed)):
        check((force[:, None], speed))


def check_samples(setting: Setting, along: Mapping[str, np.ndarray]) -> None:
    """Raise UserError for half a line of any loop, or of a joint of it.

    Args:
        setting: of all loops.
        along: values by key, arrays of one rank that broadcast, as `Samples` has them.
    """
    keys = [key for key in setting.keys if base(key) in LINE]
    if setting.plant is None or not keys:
        check(along[name] for name in LINE)
        return
    from jaxact.loops import robots  # imports MuJoCo, which a joint does not need

    scene = robots.scene(setting.plant)
    found = {name: along[name][..., None] for name in LINE}
    for key in keys:
        own = along[key][..., None]
        which = robots.matched(scene, key) & ~np.isnan(own)
        found[base(key)] = np.where(which, own, found[base(key)])
    check(found.values(), scene.labels)


def _without(other: np.ndarray, own: np.ndarray, loops: int) -> np.ndarray:
    """Whether the other one is there without this one in some loop, of the shape of joints.

    Loops of a grid are not written out: along an axis of one alone, its values meet each of the
    other's.

    Args:
        other, own: whether they are finite, of one rank.
        loops: number of axes that are of loops.
    """
    apart = [tuple(a for a in range(loops) if one.shape[a] == 1) for one in (own, other)]
    there, missing = other.any(axis=apart[0], keepdims=True), ~own.all(axis=apart[1], keepdims=True)
    return np.asarray((there & missing).any(axis=tuple(range(loops))))


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    shown = ", ".join(names[:_MOST_NAMES])
    return f"{shown} and {more} more" if more > 0 else shown
