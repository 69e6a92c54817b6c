"""Writing joints' gains in the formats of other people's files.

Every number is written with all its digits, so that it is read back as it is. What a format has no
place for stands in a comment, and in `lost`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

from jaxact.loops import toml as _toml
from jaxact.parameters import FORCE_LIMIT, KD, KP

Range = tuple[float, float]
_NO_RANGE = (-math.inf, math.inf)
_FAR = 1e30  # in place of an infinite end, which MJCF does not know


@dataclass(frozen=True)
class JointGains:
    """The gains of joints, in their order.

    Attributes:
        names: of the joints.
        kp, kd: [N m/rad, N m s/rad; of slides N/m, N s/m], as many.
        force_limit: [N m or N], inf where there is none, as many.
        least_limit: lower end of the range that each force limit is drawn from, of which
            `force_limit` is the upper end; () where none is drawn.
        force_range: lowest and highest force of joints whose limit differs by direction, +-inf of
            others, as many; () where no joint's does. Both limits hold.
        setpoint_range: positions that the model's servos clamp setpoints to [rad or m], +-inf where
            they do not, as many; () where none does.
        position: that the joints rest at [rad or m], as many; () where it is not known.
        period: of the setpoints [s]; nan where it is not known.
    """

    names: tuple[str, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    force_limit: tuple[float, ...]
    least_limit: tuple[float, ...] = ()
    force_range: tuple[Range, ...] = ()
    setpoint_range: tuple[Range, ...] = ()
    position: tuple[float, ...] = ()
    period: float = math.nan

    @property
    def limited(self) -> bool:
        """Whether a joint has a force limit."""
        return any(math.isfinite(one) for one in self.force_limit)

    @property
    def limits_drawn(self) -> bool:
        """Whether a force limit is drawn from a range."""
        return bool(self.least_limit) and self.least_limit != self.force_limit

    def forces(self, which: int) -> Range:
        """Lowest and highest force of a joint by all of its limits, +-inf where there is none."""
        low, high = self.force_range[which] if self.force_range else _NO_RANGE
        limit = self.force_limit[which]
        return max(low, -limit), min(high, limit)


UNITS = ("kp in N m/rad, kd in N m s/rad; of slides N/m, N s/m",)


def text(joints: JointGains, kind: str, source: str, more: Sequence[str] = ()) -> str:
    """The content of a file.

    Args:
        joints: what is written.
        kind: of `FORMATS`.
        source: where the gains come from, for the comment at the top.
        more: further comments, sentences.
    """
    comments = [f"Gains of {len(joints.names)} joints, from {source}, written by jaxact", *UNITS]
    return FORMATS[kind](joints, [*comments, *more, *lost(joints, kind)])


def lost(joints: JointGains, kind: str) -> list[str]:
    """What the format has no place for, or what is not known that it asks for; sentences."""
    said = []
    nowhere = "Left out, this format has no place for"
    least = joints.least_limit or joints.force_limit
    limits = [
        f"{high:g}" if low == high else f"{low:g} to {high:g}"
        for low, high in zip(least, joints.force_limit, strict=True)
    ]
    if joints.limited and kind in ("deploy-yaml", "rl-gym", "legged-gym"):
        said.append(f"{nowhere} them: force limits {', '.join(limits)}")
    elif joints.limits_drawn:
        drawn = f"ranges of force limits, {', '.join(limits)}"
        said.append(f"{nowhere} them: {drawn}; their upper ends are written")
    ranges = {
        "force limits that differ by direction": joints.force_range,
        "setpoint limits": joints.setpoint_range,
    }
    for what, own in ranges.items():
        rows = [
            f"{name} {low:g} to {high:g}"
            for name, (low, high) in zip(joints.names, own, strict=False)
            if (low, high) != _NO_RANGE
        ]  # fmt: skip
        if rows and kind != "mjcf":
            said.append(f"{nowhere} them: {what}, {', '.join(rows)}")
    if kind in ("toml", "mjcf", "legged-gym") and not math.isnan(joints.period):
        said.append(f"{nowhere} it: the period of the policy, {joints.period:g} s")
    if kind in ("deploy-yaml", "rl-gym") and not joints.position:
        said.append("The positions at rest are not known without the model")
    if kind in ("deploy-yaml", "rl-gym") and math.isnan(joints.period):
        said.append("The period of the policy is not known here: set it")
    return said


def _own(joints: JointGains, comments: Sequence[str]) -> str:
    tables: dict[str, Any] = {
        KP: dict(zip(joints.names, joints.kp, strict=True)),
        KD: dict(zip(joints.names, joints.kd, strict=True)),
    }
    limits = {name: limit for name, _, _, limit in _rows(joints) if math.isfinite(limit)}
    return _head(comments) + _toml.dumps(tables | ({FORCE_LIMIT: limits} if limits else {}))


def _mjcf(joints: JointGains, comments: Sequence[str]) -> str:
    elements = []
    for which, (name, kp, kd, _) in enumerate(_rows(joints)):
        written = {"name": name, "joint": name, KP: repr(kp), "kv": repr(kd)}
        asked = joints.setpoint_range[which] if joints.setpoint_range else _NO_RANGE
        for key, own in (("force", joints.forces(which)), ("ctrl", asked)):
            limited = own != _NO_RANGE
            if limited:
                ends = (min(max(end, -_FAR), _FAR) for end in own)
                written[f"{key}range"] = " ".join(map(repr, ends))
            if limited or key == "force":
                written[f"{key}limited"] = str(limited).lower()
        inside = " ".join(f"{key}={quoteattr(value)}" for key, value in written.items())
        elements.append(f"    <position {inside}/>\n")
    notes = "".join(f"  <!-- {one.replace('--', '- -')} -->\n" for one in comments)
    return f"<mujoco>\n{notes}  <actuator>\n{''.join(elements)}  </actuator>\n</mujoco>\n"


def _deploy(joints: JointGains, comments: Sequence[str]) -> str:
    return _yaml(comments, {
        "joint_names": list(joints.names),
        "joint_ids_map": list(range(len(joints.names))),
        **({} if math.isnan(joints.period) else {"step_dt": joints.period}),
        "stiffness": list(joints.kp),
        "damping": list(joints.kd),
        **({"default_joint_pos": list(joints.position)} if joints.position else {}),
    })  # fmt: skip


def _rl_gym(joints: JointGains, comments: Sequence[str]) -> str:
    return _yaml(comments, {
        **({} if math.isnan(joints.period) else {"control_dt": joints.period}),
        "joint_names": list(joints.names),
        "kps": list(joints.kp),
        "kds": list(joints.kd),
        **({"default_angles": list(joints.position)} if joints.position else {}),
    })  # fmt: skip


def _yaml(comments: Sequence[str], document: dict[str, Any]) -> str:
    import yaml

    body = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100)
    return _head(comments) + str(body)


def _legged_gym(joints: JointGains, comments: Sequence[str]) -> str:
    # a joint takes the last key that is part of its name: longer names come later
    order = sorted(range(len(joints.names)), key=lambda i: len(joints.names[i]))
    kp = {joints.names[i]: joints.kp[i] for i in order}
    kd = {joints.names[i]: joints.kd[i] for i in order}
    return (
        f"{_head(comments)}class control:\n"
        f"    stiffness = {_table(kp, 8)}\n    damping = {_table(kd, 8)}\n"
    )


def _isaac_lab(joints: JointGains, comments: Sequence[str]) -> str:
    patterns = [re.escape(name) for name in joints.names]
    fields = [
        ("stiffness", dict(zip(patterns, joints.kp, strict=True))),
        ("damping", dict(zip(patterns, joints.kd, strict=True))),
    ]
    limits = [one if math.isfinite(one) else 1e9 for one in joints.force_limit]
    if joints.limited:
        fields.append(("effort_limit", dict(zip(patterns, limits, strict=True))))
    rows = "".join(f"        {name}={_table(table, 12)},\n" for name, table in fields)
    return (
        f"{_head(comments)}from isaaclab.actuators import IdealPDActuatorCfg\n\n"
        'ACTUATORS = {\n    "joints": IdealPDActuatorCfg(\n'
        f"        joint_names_expr={patterns!r},\n{rows}    ),\n}}\n"
    )


def _mjlab(joints: JointGains, comments: Sequence[str]) -> str:
    groups: dict[tuple[float, float, float], list[str]] = {}
    for name, *numbers in _rows(joints):
        groups.setdefault((numbers[0], numbers[1], numbers[2]), []).append(re.escape(name))
    rows = []
    for (kp, kd, limit), names in groups.items():
        effort = f"        effort_limit={limit!r},\n" if math.isfinite(limit) else ""
        rows.append(
            f"    IdealPdActuatorCfg(\n        target_names_expr={tuple(names)!r},\n"
            f"        stiffness={kp!r},\n        damping={kd!r},\n{effort}    ),\n"
        )
    return (
        f"{_head(comments)}from mjlab.actuator import IdealPdActuatorCfg\n\n"
        f"ACTUATORS = (\n{''.join(rows)})\n"
    )


def _rows(joints: JointGains) -> Iterator[tuple[str, float, float, float]]:
    """Name, kp, kd and force limit of each joint."""
    return zip(joints.names, joints.kp, joints.kd, joints.force_limit, strict=True)


def _table(table: dict[str, float], indent: int) -> str:
    rows = "".join(f"{' ' * indent}{name!r}: {value!r},\n" for name, value in table.items())
    return f"{{\n{rows}{' ' * (indent - 4)}}}"


def _head(comments: Sequence[str]) -> str:
    return "".join(f"# {' '.join(one.split())}\n" for one in comments) + "\n"


FORMATS: dict[str, Callable[[JointGains, Sequence[str]], str]] = {
    "toml": _own, "mjcf": _mjcf, "deploy-yaml": _deploy, "rl-gym": _rl_gym,
    "legged-gym": _legged_gym, "isaaclab": _isaac_lab, "mjlab": _mjlab,
}  # fmt: skip
