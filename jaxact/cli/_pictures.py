"""What `jaxact bode`, `nyquist` and `sensitivity` have in common: options in, one picture out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from jaxact.cli import _loops
from jaxact.errors import UserError, nearest, shown
from jaxact.loops.checks import OF_VELOCITY, check_velocity
from jaxact.verbs import naming

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
        help="Velocity that the controller sees: sensed, or positions differenced, which"
        " --velocity-filter filters.",
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


@dataclass(frozen=True)
class Chosen:
    """What the options name: the loops, whether to sample them as well, and with which velocity."""

    loops: _loops.Loops
    sampled: bool
    velocity: str


def chosen_loops(parameters: Any, file: Path | None, velocity: str) -> Chosen:
    """The loops that the options name.

    parameters: of type `Linear`
    file: of loops, None for none
    velocity: as given; "differenced" too where the file says so

    Raises UserError for options that have no effect on any of the loops.
    """
    if velocity not in VELOCITIES:
        raise UserError(f"--velocity {shown(velocity)}; {nearest(velocity, VELOCITIES)}")
    given = _loops.given(parameters)
    if file is None:
        loops = _loops.linear_combinations(given, velocity=velocity)
        sampled = "control_rate" in given
    else:
        loops = _loops.from_file(file, given)
        sampled = "control_rate" in given or "control_rate" in loops.said
        velocity = "differenced" if loops.velocity == "differenced" else velocity
        check_velocities(loops, velocity, file)
    if file is None and not sampled:
        check_continuous(loops, velocity)
    _loops.say_what_is_left_out(loops)
    return Chosen(loops, sampled, velocity)


def check_continuous(loops: _loops.Loops, velocity: str) -> None:
    """Raise UserError where differencing would be ignored in continuous time."""
    if velocity == "differenced" and np.isinf(loops.values["velocity_filter"]).all():
        raise UserError(
            "--velocity differenced: has no effect in continuous time without a filter; add"
            " --control-rate or --velocity-filter"
        )


def check_velocities(loops: _loops.Loops, velocity: str, file: Path) -> None:
    """Raise UserError where loops of a file have what their kind of velocity does without."""
    for name in OF_VELOCITY:
        key = f"{file}: {name}"
        check_velocity(name, loops.values[name], key, differenced=velocity == "differenced")


def draw(
    picture: Callable[..., Any],
    parameters: Any,
    file: Path | None,
    velocity: str,
    title: str,
    out: Path,
) -> None:
    """Compute the responses of the loops, draw the picture, write it and say so."""
    from jaxact.plotting import theme

    theme.check_output(out)
    chosen = chosen_loops(parameters, file, velocity)

    from jaxact.verbs.responses import responses

    loops = named(chosen.loops)
    drawn = responses(loops, sampled=chosen.sampled, velocity=chosen.velocity)
    figure = picture(drawn, title=title, footer=footer(loops, chosen.velocity))
    theme.write(figure, out, title=title or f"jaxact {picture.__name__}")
    print(f"wrote {out}")


def footer(loops: _loops.Loops, velocity: str) -> str:
    """What all loops have in common: gains, mass, actuator, delay, and how velocity is had."""
    own, words = loops.values, []
    for name, unit in (("kp", "N/m"), ("kd", "N s/m"), ("mass", "kg")):
        if _common(own[name]):
            words.append(f"{name} {own[name][0]:g} {unit}")
    if len(loops) > 1:  # a single one is named by its actuator and its delay
        words += naming.common_words({name: v[0] for name, v in own.items() if _common(v)})
    cutoff = own["velocity_filter"]
    how = [] if velocity != "differenced" else ["differenced"]
    if _common(cutoff) and np.isfinite(cutoff[0]):
        how.append(f"filtered at {cutoff[0]:g} rad/s")
    return ", ".join([*words, f"velocity {' and '.join(how)}"] if how else words)


def named(loops: _loops.Loops) -> _loops.Loops:
    """The loops as a picture calls them: with their velocity filters, where these differ."""
    cutoff = loops.values["velocity_filter"]
    if _common(cutoff):
        return loops
    labels = [
        label if "velocity filter" in label else f"{label}, {_filter(float(value))}"
        for label, value in zip(loops.labels, cutoff, strict=True)
    ]
    return replace(loops, labels=tuple(labels))


def _filter(cutoff: float) -> str:
    return f"velocity filter {cutoff:g} rad/s" if np.isfinite(cutoff) else "no velocity filter"


def _common(values: np.ndarray) -> bool:
    """Whether all loops have the same value."""
    return bool((values == values[0]).all())
