"""What is said about a field of a model: what the engines make of it, and what jaxact does."""

from __future__ import annotations

from dataclasses import dataclass

LIFTED = "lifted"
"""Taken out of the model into the drive, where its effect is the same."""

EMULATED = "emulated"
"""Expressed by what every engine knows; its effect is the same, apart from numerical error."""

HARMLESS = "ignored harmlessly"
"""Left out; what it changes is said, and the stability of the loops is not among it."""

INEXACT = "not exact in MJX"
"""MJX simulates it otherwise than MuJoCo, by more than rounding: `engine = "auto"` does without
MJX, and whoever asks for MJX is told."""

ASKED = "as asked"
"""Otherwise than the model has it, because the user says so."""

REFUSED = "refused"
"""Cannot be simulated as the model has it."""

GROUP_OFF = "actuatorgroupdisable"
"""The field that switches actuators off by their group; they are not driven."""

MJX = "mjx"
MUJOCO = "mujoco"
WARP = "warp"
ENGINES = (MJX, MUJOCO, WARP)


@dataclass(frozen=True)
class Finding:
    """One field of a model that needs a word.

    Attributes:
        where: the element, e.g. "actuator 'knee'".
        field: the attribute's name in MJCF, or what it is about.
        value: as the model has it.
        mjx: what MJX does with it by itself.
        action: `LIFTED`, `EMULATED`, `HARMLESS`, `INEXACT`, `ASKED` or `REFUSED`: what jaxact does.
        advice: how that is done, or what to change where it is refused; a sentence.
        engines: the engines that cannot simulate it; empty unless refused.
    """

    where: str
    field: str
    value: str
    mjx: str
    action: str
    advice: str
    engines: tuple[str, ...] = ()


def refused(
    where: str,
    field: str,
    value: str,
    mjx: str,
    advice: str,
    engines: tuple[str, ...] = ENGINES,
) -> Finding:
    """A finding that stops these engines."""
    return Finding(where, field, value, mjx, REFUSED, advice, engines)


def named(element: str, name: str, index: int) -> str:
    """An element as messages name it: by its name, else by its number."""
    return f"{element} '{name}'" if name else f"{element} {index}"
