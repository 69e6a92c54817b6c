"""Parameters that are given anew over those that a loop or a specification has.

Of several values of a parameter that are meant for a joint the one whose key comes last counts, and
one for some joints before that for all. What is given anew would count for nothing, were the older
keys for some joints (`kp@.*_knee`) kept beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from jaxact.parameters import WN, ZETA, base


def replaced(key: str, given: Iterable[str]) -> bool:
    """Whether a key for some joints is one that these replace: the same, or those of all joints.

    Args:
        key: short name of a parameter, or a key of it for some joints; the first is never replaced
            in this sense.
        given: keys that are given anew, or `actuator`, which sets wn and zeta.
    """
    names = set(given)
    names |= {WN, ZETA} if "actuator" in names else set()
    return "@" in key and not names.isdisjoint({key, base(key), f"{base(key)}@.*"})


def over(values: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters, and over them those that are given anew; the latter's keys come last.

    Args:
        values, given: by short name, or key for some joints.
    """
    return {key: value for key, value in values.items() if not replaced(key, given)} | dict(given)
