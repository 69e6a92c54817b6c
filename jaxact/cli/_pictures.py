"""What `jaxact bode`, `nyquist` and `sensitivity` have in common: options in, one picture out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxact.cli import _loops
from jaxact.parameters import CONTROL_RATE


def draw(
    picture: Callable[..., Any],
    parameters: Any,
    file: Path | None,
    velocity: str | None,
    title: str,
    out: Path,
) -> None:
    """Compute the responses of the loops, draw the picture, write it and say so.

    Args:
        picture: of responses.
        parameters: options of `_loops.Linear`.
        file: of loops, None for none.
        velocity: that the controllers see.
        title: above the picture.
        out: file to write.
    """
    from jaxact.plotting import theme

    theme.check_output(out)
    loop = _loops.linear(parameters, file, velocity)

    from jaxact.verbs import naming
    from jaxact.verbs.responses import responses

    drawn = responses(loop, sampled=CONTROL_RATE in loop.values)
    figure = picture(drawn, title=title, footer=naming.in_common(loop))
    theme.write(figure, out, title=title or f"jaxact {picture.__name__}")
    print(f"wrote {out}")
