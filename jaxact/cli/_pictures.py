"""What `jaxact bode`, `nyquist` and `sensitivity` have in common: options in, one picture out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from jaxact.cli import _loops
from jaxact.errors import UserError, nearest, shown

# Which loops: every option takes several values, and all combinations are drawn.
Linear = _loops.options((*_loops.LINEAR, "control_rate"), several=True)

LoopsFile = Annotated[
    Path | None,
    arg(
        metavar="FILE",
        help="TOML file of loops: [[loop]] tables, or the axes of a sweep's specification.",
        help_behavior_hint="(default: none)",
    ),
]
Velocity = Annotated[
    str,
    arg(
        metavar="sampled|differenced",
        help="Velocity that the sampled controller sees: sensed, or positions differenced.",
    ),
]
Title = Annotated[
    str, arg(metavar="TEXT", help="Above the picture.", help_behavior_hint="(default: none)")
]
Out = Annotated[
    Path,
    arg(
        metavar="FILE",
        help="Picture to write: .png, .svg or .pdf; one that is there is replaced.",
    ),
]
VELOCITIES = ("sampled", "differenced")


def chosen_loops(parameters: Any, file: Path | None, velocity: str) -> tuple[_loops.Loops, bool]:
    """The loops that the options name, and whether they are to be sampled as well.

    parameters: of type `Linear`
    file: of loops, None for none
    velocity: checked here
    """
    if velocity not in VELOCITIES:
        raise UserError(f"--velocity {shown(velocity)}; {nearest(velocity, VELOCITIES)}")
    given = _loops.given(parameters)
    if file is None:
        return _loops.combinations(given, velocity=velocity), "control_rate" in given
    loops = _loops.from_file(file, given)
    return loops, "control_rate" in given or "control_rate" in loops.said


def draw(
    picture: Callable[..., Any],
    parameters: Any,
    file: Path | None,
    velocity: str,
    title: str,
    out: Path,
) -> None:
    """Compute the responses of the loops, draw the picture, write it and say so."""
    from jaxact.plot import look

    look.check_output(out)
    loops, sampled = chosen_loops(parameters, file, velocity)

    from jaxact.cli._responses import responses

    drawn = responses(loops, sampled=sampled, velocity=velocity)
    figure = picture(drawn, title=title, footer=footer(loops))
    look.write(figure, out, title=title or f"jaxact {picture.__name__}")
    print(f"wrote {out}")


def footer(loops: _loops.Loops) -> str:
    """The gains and the mass, where all loops share them."""
    words = []
    for name, unit in (("kp", "N/m"), ("kd", "N s/m"), ("mass", "kg")):
        values = loops.values[name]
        if (values == values[0]).all():
            words.append(f"{name} {values[0]:g} {unit}")
    return ", ".join(words)
