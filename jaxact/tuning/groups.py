"""Joints that share their gains: groups by patterns of names, and their log-gains as one vector.

x = (ln kp_1 ... ln kp_g, ln kd_1 ... ln kd_g)
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.errors import UserError, shown


@dataclass(frozen=True)
class Groups:
    """Which joints share their gains; g groups of m joints.

    Attributes:
        names: of the groups.
        members: number of the group of each joint, shape (m,).
        joints: names of the joints.
    """

    names: tuple[str, ...]
    members: np.ndarray
    joints: tuple[str, ...]

    def __len__(self) -> int:
        """Number of groups."""
        return len(self.names)

    @property
    def spread(self) -> np.ndarray:
        """1 where a joint belongs to a group, shape (m, g)."""
        return np.eye(len(self))[self.members]

    @property
    def first(self) -> np.ndarray:
        """Number of the first joint of each group, shape (g,)."""
        return self.spread.argmax(axis=0)

    @property
    def share(self) -> np.ndarray:
        """Share of each group in the joints, shape (g,)."""
        return self.spread.mean(axis=0)

    def gains(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """kp and kd of every joint at log-gains x of shape (2 g,); shape (m,) each."""
        gains = np.exp(np.asarray(x, float).reshape(2, len(self)))
        return gains[0, self.members], gains[1, self.members]

    def log_gains(self, kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
        """x of gains of the joints, shape (m,) each: of each group the geometric mean."""
        weights = self.spread / self.spread.sum(axis=0)
        return np.concatenate([np.log(kp) @ weights, np.log(kd) @ weights])


def group(patterns: Sequence[str], names: Sequence[tuple[str, str]]) -> Groups:
    """The groups of a robot's joints.

    Args:
        patterns: regular expressions that are found anywhere in the name of a joint or of its
            actuator, one for each group; none: every joint is a group of its own.
        names: of each driven joint and of its actuator.

    Raises:
        UserError: a pattern that is not valid or matches nothing, joints that two patterns match,
            and joints that none does.
    """
    joints = tuple(joint for joint, _ in names)
    if not patterns:
        return Groups(joints, np.arange(len(joints)), joints)
    if len(set(patterns)) < len(patterns):
        raise UserError("`groups`: the same pattern is given twice")
    members = np.full(len(joints), -1)
    for number, pattern in enumerate(patterns):
        found = _matching(pattern, names)
        if not found.size:
            raise UserError(
                f"`groups` {shown(pattern)}: matches no driven joint; they are {', '.join(joints)}"
            )
        taken = found[members[found] >= 0]
        if taken.size:
            other = patterns[int(members[taken[0]])]
            raise UserError(
                f"`groups`: joint '{joints[taken[0]]}' matches both {shown(other)} and "
                f"{shown(pattern)}; a joint belongs to one group"
            )
        members[found] = number
    left = [joint for joint, own in zip(joints, members, strict=True) if own < 0]
    if left:
        raise UserError(
            f"`groups`: joint '{left[0]}' is in no group; add a pattern for it, or leave it "
            "undriven with `joints`"
        )
    return Groups(tuple(patterns), members, joints)


def _matching(pattern: str, names: Sequence[tuple[str, str]]) -> np.ndarray:
    """Numbers of the joints that a pattern matches."""
    if not pattern:
        raise UserError("`groups`: a pattern is empty; write NAME,NAME,...")
    try:
        expression = re.compile(pattern)
    except re.error as error:
        raise UserError(
            f"`groups` {shown(pattern)}: is not a regular expression ({error})"
        ) from None
    hits = [any(expression.search(name) for name in pair) for pair in names]
    return np.flatnonzero(hits)
