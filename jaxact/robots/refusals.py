"""What would help where MuJoCo refuses to read or compile a model, and where to write it."""

from __future__ import annotations

import re

_ELEMENT = re.compile(r" ?Element name '([^']*)', id \d+(, line \d+)?")
_FUSED = " The static bodies of the spec were fused before this error, and remain so."


def explained(error: Exception | str, *, urdf: bool) -> str:
    """MuJoCo's reason in one line, and where it is known what would help.

    Args:
        error: that MuJoCo raised.
        urdf: whether the model is a URDF, in which MuJoCo's options have a place of their own.
    """
    said = " ".join(str(error).split()).replace(_FUSED, "")
    where = _ELEMENT.search(said)
    body = f"{'link' if urdf else 'body'} '{where[1]}'" if where and where[1] else "a body"
    for sign, what, options in _KNOWN:
        if sign in said:
            return what.format(said=said, body=body, option=_option(options, urdf=urdf))
    return said


def _option(attributes: str, *, urdf: bool) -> str:
    """Where to write options of MuJoCo's compiler."""
    line = f"<compiler {attributes}/>"
    if urdf:
        return f"<mujoco>{line}</mujoco> inside <robot>"
    return f"{line} inside <mujoco>"


_KNOWN = (
    (
        "use 'balanceinertia' to fix",
        "the inertia of {body} is that of no rigid body (one principal moment exceeds the sum of "
        "the others); correct it, or write {option} and MuJoCo takes their mean",
        'balanceinertia="true"',
    ),
    (
        "inertia must have positive eigenvalues",
        "the inertia of {body} is not positive definite; correct ixx to iyz, or give only the "
        "diagonal",
        "",
    ),
    (
        "mass and inertia of moving bodies must be larger than",
        "{body} moves, but has no mass or no inertia; give it an inertial, or write {option} to "
        "give all such bodies a little",
        'boundmass="1e-3" boundinertia="1e-6"',
    ),
    (
        "no decoder found for mesh file",
        "{said}; convert it to STL or OBJ",
        "",
    ),
)
"""What MuJoCo says, what is said instead, and the attributes of <compiler> that help."""
