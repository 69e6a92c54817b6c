"""What a picture is drawn on: Matplotlib's axes that are given, or new ones."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from jaxact.errors import UserError

_P = ParamSpec("_P")
_R = TypeVar("_R")


def on_axes(picture: Callable[_P, _R]) -> Callable[_P, _R]:
    """A decorator: a picture whose `ax` or `axes`, where they are given, must be axes.

    The picture raises UserError for what is none, a figure or an array of them for one, and for
    axes that are not rectilinear.
    """

    @functools.wraps(picture)
    def checked(*inputs: _P.args, **named: _P.kwargs) -> _R:
        ax, axes = named.get("ax"), named.get("axes")
        if ax is not None:
            _demand("ax", ax)
        if axes is not None:
            for one in np.ravel(np.array(axes, dtype=object)):
                _demand("axes", one)
        return picture(*inputs, **named)

    return checked


def _demand(name: str, given: Any) -> None:
    if not isinstance(given, Axes):
        what = "one of them (several as `axes`)" if name == "ax" else "a list of them"
        raise UserError(
            f"{name}: a value of type {type(given).__name__} is not Matplotlib's axes; give "
            f"{what}, e.g. of matplotlib.pyplot.subplots()"
        )
    if given.name != "rectilinear":
        raise UserError(f"{name}: these axes are {given.name}; give rectilinear ones")


def stacked(heights: Sequence[float]) -> Sequence[Axes]:
    """Axes of a new figure over each other, of these heights, with time or the like in common."""
    ratios = {"height_ratios": heights}
    axes: Sequence[Axes] = pyplot.subplots(len(heights), 1, sharex=True, gridspec_kw=ratios)[1]
    return axes
