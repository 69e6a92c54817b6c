"""Gains in the YAML files that policies are deployed with: lists in the order of the joints.

Formats: unitree_rl_lab's `deploy.yaml` (gains in the order of the motors; entry k of
`joint_ids_map` is the motor of the policy's joint k), unitree_rl_gym's `deploy/*/configs/*.yaml`,
rl_sar's `base.yaml` and `config.yaml` (all lists in the order of `joint_names`; where there is a
`joint_mapping`, entry i of the lists is the motor of that number, and the names are the motors').
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxact.errors import UserError, nearest, shown
from jaxact.gains.table import Entry, GainFile
from jaxact.parameters import FORCE_LIMIT, KD, KP

_ASSUMED = "it names no joints: its gains are taken to be in the order of the model's driven joints"
_MOTORS = "motor i is taken to be the model's driven joint i, from 0"

_MOST_MOTORS = 10_000
_TOP = "the top"  # of a file, in messages
# Lists of unitree_rl_gym: motors of the joints, of which the first is more common, and what a file
# may have for the arms and the waist: motors, stiffness and damping.
_LEGS = ("leg_joint2motor_idx", "joint2motor_idx")
_ARMS = ("arm_waist_joint2motor_idx", "arm_waist_kps", "arm_waist_kds")


def unitree(path: Path, document: Mapping[str, Any]) -> GainFile | None:
    """Of a `deploy.yaml`; None where it is not one."""
    if not all(isinstance(document.get(key), list) for key in ("stiffness", "damping")):
        return None
    kp, kd = (numbers(path, key, document[key]) for key in ("stiffness", "damping"))
    _same_length(path, {"stiffness": kp, "damping": kd})
    notes = unused(document, ("default_joint_pos", "step_dt", "actions"))
    ids = document.get("joint_ids_map")
    names = document.get("joint_names")
    if isinstance(ids, list) and ids and all(isinstance(one, str) for one in ids):
        ids, names = None, ids  # some write the names themselves there
    motors = _motors(path, ids, len(kp))
    if names is None:
        order = sorted(motors)
        rows = [(place, kp[motor], kd[motor]) for place, motor in enumerate(order)]
        return _file(path, "deploy-yaml", rows, "place", (_ASSUMED, *notes))
    listed = _names(path, names)
    _same_length(path, {"joint_names": listed, "joint_ids_map": motors})
    named = [(name, kp[m], kd[m]) for name, m in zip(listed, motors, strict=True)]
    return _file(path, "deploy-yaml", named, "name", notes)


def rl_gym(path: Path, document: Mapping[str, Any]) -> GainFile | None:
    """Of a file with `kps` and `kds`; None where it is not one."""
    if not {"kps", "kds"} <= set(document):
        return None
    kp, kd = (numbers(path, key, document[key]) for key in ("kps", "kds"))
    _same_length(path, {"kps": kp, "kds": kd})
    keys: tuple[str, ...] = (
        "default_angles", "simulation_dt", "control_dt", "control_decimation", "action_scale",
        "arm_waist_target",
    )  # fmt: skip
    if "joint_names" in document:
        notes = unused(document, (*keys, *_ARMS))
        return named_file(path, "rl-gym", document["joint_names"], {"kps": kp, "kds": kd}, notes)
    motors = _legs(path, document, len(kp))
    if motors is None:
        rows = list(zip(range(len(kp)), kp, kd, strict=True))
        return _file(path, "rl-gym", rows, "place", (_ASSUMED, *unused(document, (*keys, *_ARMS))))
    if all(isinstance(document.get(key), list) for key in _ARMS):
        waist = _motors(path, document[_ARMS[0]], None, key=_ARMS[0])
        own = [numbers(path, key, document[key]) for key in _ARMS[1:]]
        _same_length(path, dict(zip(_ARMS, (waist, *own), strict=True)))
        motors, kp, kd = motors + waist, kp + own[0], kd + own[1]
        _motors(path, motors, None, key="the motors of all its joints")
    else:
        keys = (*keys, *_ARMS)
    rows = list(zip(motors, kp, kd, strict=True))
    return _file(path, "rl-gym", rows, "motor", (_MOTORS, *unused(document, keys)))


def _legs(path: Path, document: Mapping[str, Any], count: int) -> list[int] | None:
    """Numbers of the motors of so many gains of unitree_rl_gym; None where the file has none.

    Raises:
        UserError: none of its lists is as long, or several that differ are.
    """
    lists = {key: document[key] for key in _LEGS if document.get(key) is not None}
    fitting = {
        key: _motors(path, ids, None, key=key)
        for key, ids in lists.items()
        if not isinstance(ids, list) or len(ids) == count
    }
    if lists and not fitting:
        key, ids = next(iter(lists.items()))
        _same_length(path, {"kps": range(count), key: ids})
    first = next(iter(fitting.values()), None)
    if any(one != first for one in fitting.values()):
        raise UserError(f"{path}: {' and '.join(fitting)} differ; leave one of them out")
    return first


def rl_sar(path: Path, document: Mapping[str, Any], name: str | None = None) -> GainFile | None:
    """Of a file with `rl_kp` and `rl_kd`, or with `fixed_...`; None where it is not one.

    Args:
        path: of the file.
        document: that it has: such a table, or one for each robot.
        name: of the one robot that is meant, in full or its last parts; None for whatever it has.

    Raises:
        UserError: it has several such tables, whose gains differ, or none of that name.
    """
    tables: dict[str, Any] = {} if name is not None else {_TOP: document}
    tables |= {str(key): value for key, value in document.items() if isinstance(value, Mapping)}
    kinds = {
        robot: [one for one in ("rl", "fixed") if {f"{one}_kp", f"{one}_kd"} <= set(table)]
        for robot, table in tables.items()
    }
    known = [robot for robot, own in kinds.items() if own]
    if name is not None and known:
        fits = [robot for robot in known if f"/{robot}".endswith(f"/{name}")]
        if name not in fits and len(fits) != 1:
            raise UserError(f"{path}: has no single robot {name!r}; {nearest(name, known)}")
        known = [name] if name in fits else fits
    found = [(robot, _rl_sar(path, tables[robot], kinds[robot][0])) for robot in known]
    for robot, one in found[1:]:
        if set(one.entries) != set(found[0][1].entries):
            first = found[0][0]
            remedy = f"name one: {path}:{robot if first == _TOP else first}"
            raise UserError(
                f"{path}: has several robots, {first} and {robot}, whose gains differ; {remedy}"
            )
    return found[0][1] if found else None


def _rl_sar(path: Path, table: Mapping[str, Any], kind: str) -> GainFile:
    lists = {f"{kind}_kp": KP, f"{kind}_kd": KD, "torque_limits": FORCE_LIMIT}
    given = {key: numbers(path, key, table[key]) for key in lists if key in table}
    _same_length(path, given)
    motors = None
    if "joint_mapping" in table:
        count = len(given[f"{kind}_kp"])
        motors = _motors(path, table["joint_mapping"], count, key="joint_mapping")
        _same_length(path, {"joint_mapping": motors, **given})
    notes = unused(table, ("default_dof_pos", "dt", "decimation", "action_scale"))
    joints: Sequence[Any]
    keys: Any
    if "joint_names" in table:
        names = _names(path, table["joint_names"])
        _same_length(path, {"joint_names": names, **given})
        # Its programs take the names in the order of the motors where there is a mapping.
        joints, keys = names if motors is None else [names[motor] for motor in motors], "name"
    elif motors is not None:
        joints, keys, notes = motors, "motor", (_MOTORS, *notes)
    else:
        joints, keys = range(len(given[f"{kind}_kp"])), "place"
        notes = (_ASSUMED, *notes)
    if kind == "fixed":
        notes = ("its gains are those that it stands up with; it has no rl_kp", *notes)
    entries = tuple(
        Entry(lists[key], joint, value)
        for key, values in given.items()
        for joint, value in zip(joints, values, strict=True)
    )
    return GainFile(path, "rl-sar", entries, keys, notes)


def numbers(path: Path, key: str, value: Any) -> list[float]:
    """A list of numbers.

    Raises:
        UserError: it is something else.
    """
    if isinstance(value, list) and value:
        try:
            return [number(path, key, one) for one in value]
        except RecursionError:  # an alias of YAML that contains itself
            pass
    raise UserError(f"{path}: {key} = {shown(value)}; give a list of numbers, one a joint")


def number(path: Path, key: str, value: Any) -> float:
    """A number.

    Raises:
        UserError: it is something else.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UserError(f"{path}: {key} = {shown(value)}; give a number")
    return float(value)


def _file(
    path: Path, kind: str, rows: Sequence[tuple[Any, float, float]], keys: Any,
    notes: Sequence[str],
) -> GainFile:  # fmt: skip
    entries = [Entry(KP, key, kp) for key, kp, _ in rows] + [Entry(KD, k, d) for k, _, d in rows]
    return GainFile(path, kind, tuple(entries), keys, tuple(notes))


def _names(path: Path, value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(one, str) and one for one in value):
        raise UserError(f"{path}: joint_names = {shown(value)}; give a list of names")
    if len(set(value)) < len(value):
        twice = next(one for one in value if value.count(one) > 1)
        raise UserError(f"{path}: joint_names has {shown(twice)} twice")
    return list(value)


def _motors(path: Path, ids: Any, count: int | None, key: str = "joint_ids_map") -> list[int]:
    """Numbers of the policy's joints' motors; in order where the file does not say."""
    if ids is None and count is not None:
        return list(range(count))
    whole = isinstance(ids, list) and all(
        isinstance(one, int | float) and not isinstance(one, bool) and one in range(_MOST_MOTORS)
        for one in ids
    )
    if not whole or len({int(one) for one in ids}) < len(ids):
        raise UserError(
            f"{path}: {key} = {shown(ids)}; give the number of each joint's motor, from 0,"
            " each once"
        )
    if count is not None and any(one >= count for one in ids):
        raise UserError(f"{path}: {key} has motor {int(max(ids))}, and there are gains of {count}")
    return [int(one) for one in ids]


def _same_length(path: Path, lists: Mapping[str, Sequence[Any]]) -> None:
    first, *others = lists.items()
    for name, values in others:
        if len(values) != len(first[1]):
            raise UserError(
                f"{path}: {first[0]} has {len(first[1])} entries and {name} has {len(values)};"
                " give one of each for every joint"
            )


def named_file(
    path: Path, kind: str, names: Any, lists: Mapping[str, list[float]], notes: Sequence[str]
) -> GainFile:
    """A file of names and two lists, stiffness and damping, in their order.

    Raises:
        UserError: a name is there twice, or the lists are not equally long.
    """
    listed = _names(path, names)
    _same_length(path, {"joint_names": listed, **lists})
    return _file(path, kind, list(zip(listed, *lists.values(), strict=True)), "name", notes)


def unused(document: Mapping[str, Any], keys: Sequence[str]) -> tuple[str, ...]:
    """What of a file gains do not carry, as a note."""
    found = [key for key in keys if key in document]
    return (f"not taken from it: {', '.join(found)}",) if found else ()
