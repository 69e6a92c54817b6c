"""`jaxact plot`: pictures of a sweep's results."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxact.cli import _warnings
from jaxact.errors import UserError

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from jaxact.plot.panels import Arrangement

_GAINS = ("kp", "kd")


def main(
    result: Annotated[
        tyro.conf.Positional[str],
        tyro.conf.arg(
            metavar="RESULT",
            help="Results folder of a sweep, or the store in it; path or URL.",
        ),
    ],
    *,
    x: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="NAME",
            help="Parameter along x.",
            help_behavior_hint="(default: kp where it was swept, else the first)",
        ),
    ] = None,
    y: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="NAME",
            help="Parameter along y (of --kind lines: a curve for each value).",
            help_behavior_hint="(default: kd where it was swept, else the second)",
        ),
    ] = None,
    facet: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME",
            help="One panel for each value: one parameter, or two for rows and columns.",
            help_behavior_hint="(default: what is left over)",
        ),
    ] = (),
    select: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(
            metavar="NAME=VALUE",
            help="Keep only the nearest value of a parameter, in its SI unit (delay in s). "
            "Can be repeated.",
        ),
    ] = (),
    variable: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="NAME",
            help="Result to colour, e.g. overshoot, settling_time, peak_force.",
            help_behavior_hint="(default: growth_rate; shaking_rate where robots topple)",
        ),
    ] = None,
    kind: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="map|scatter|lines",
            help="What to draw.",
            help_behavior_hint="(default: map for a grid, scatter for a random sample, lines for "
            "a single axis)",
        ),
    ] = None,
    nominal: Annotated[
        tuple[float, ...],
        tyro.conf.arg(
            metavar="X Y",
            help="Point to mark.",
            help_behavior_hint="(default: the specification's own parameters)",
        ),
    ] = (),
    title: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="TEXT",
            help="Above the picture.",
            help_behavior_hint="(default: the sweep's description)",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Picture to write: .png, .svg or .pdf; one that is there is replaced.",
            help_behavior_hint="(default: stability_map.png in the results folder)",
        ),
    ] = None,
    quick: Annotated[
        bool,
        tyro.conf.arg(help="Leave out the comparison of every verdict with exact theory."),
    ] = False,
) -> None:
    """Draw the stability map of a sweep, with the exact boundary over it.

    The growth rate [1/s] of every loop is coloured (blue decays, brown grows), verdicts other than
    stable are hatched, and the exact boundary is drawn for the sampled loop (solid) and in
    continuous time (dashed). Where robots topple it is the shaking rate that is coloured: what
    gains and delays change. Units are SI: kp [N/m], kd [N s/m], delays [s].

    examples:
      jaxact plot results/paper_gain_map
      jaxact plot results/paper_gain_map --facet delay actuator --out map.pdf
      jaxact plot results/paper_gain_map --variable overshoot --select actuator=hyq
      jaxact margins --loops sweep.toml --store m.zarr && jaxact plot m.zarr --variable gain_margin
      jaxact plot results/paper_gain_map --kind lines --x kd --y delay --select kp=400
    """
    from jaxact.plot import field, look, panels, regular
    from jaxact.sweep import opening

    if out is not None:
        look.check_output(out)
    _warnings.older(result)
    results = opening.load_result(result)
    computed = results if regular.refined(results) else None
    if computed is not None:
        results = regular.regular(computed)
    shown = field.usual(results) if variable is None else variable
    arrangement = panels.arrange(
        results,
        kind=kind,  # type: ignore[arg-type] # checked there
        x=x,
        y=y,
        facet=facet,
        select=_pairs(select),
    )
    figure, said = _draw(
        results, arrangement, shown, nominal, title, computed=computed, quick=quick
    )
    path = (
        out
        if out is not None
        else _default_output(result, arrangement.kind, shown, usual=shown == field.usual(results))
    )
    look.write(figure, path, title=f"jaxact: {shown}")
    print(said)
    print(f"wrote {path}")


def _draw(
    results: xr.Dataset,
    arrangement: Arrangement,
    variable: str,
    nominal: tuple[float, ...],
    title: str | None,
    *,
    computed: xr.Dataset | None,
    quick: bool,
) -> tuple[Figure, str]:
    """The figure, and its small print, about the loops computed where others are shown."""
    from jaxact.plot import caption, field, lines, scatter, stability_map
    from jaxact.sweep import agreement, margins_store

    field.field(results, variable)  # a misspelt name is told before anything is computed
    boundaries = _boundaries(arrangement)
    drawn = any(boundary is not None for boundary in boundaries)
    computed = arrangement.data if computed is None else computed
    exact = margins_store.KIND in results.attrs
    found = None if quick or exact else agreement.sweep_agreement(computed)
    parts = [
        f"Shown: {', '.join(arrangement.selected)}." if arrangement.selected else "",
        caption.exact(computed) if exact else caption.simulated(computed),
        caption.compared(found) if found is not None else "",
        caption.linear_only(arrangement.data) if drawn or found is not None else "",
    ]
    footer = " ".join(part for part in parts if part)
    heading = results.attrs.get("title", "") if title is None else title
    shared: dict[str, Any] = {"variable": variable, "title": heading, "footer": footer}
    marked = _nominal(results, arrangement, nominal)
    if arrangement.kind == "lines":
        shared["nominal"] = None if marked is None else marked[0]
        return lines.lines(results, arrangement, **shared), footer
    shared |= {"boundaries": boundaries, "nominal": marked}
    if arrangement.kind == "scatter":
        return scatter.scatter(results, arrangement, **shared), footer
    shared["linearised"] = not agreement.is_plain_mass(results)
    return stability_map.stability_map(results, arrangement, **shared), footer


def _boundaries(arrangement: Arrangement) -> list[Any]:
    """The exact boundary of every panel, over whichever two numbers it shows."""
    from jaxact.plot.stability_map import cell_edges
    from jaxact.sweep import exact_lines
    from jaxact.sweep.parameters import known, of

    axes = [axis for axis in (arrangement.x, arrangement.y) if axis is not None]
    drawable = len(axes) == 2 and all(a.scale != "category" and known(a.name) for a in axes)
    if arrangement.kind == "lines" or not drawable:
        return [None] * len(arrangement.panels)
    windows = []
    for axis in axes:
        edges, bounds = cell_edges(axis), of(axis.name)
        ends = max(float(edges[0]), bounds.minimum), min(float(edges[-1]), bounds.maximum)
        windows.append(exact_lines.Window(axis.name, *ends, axis.scale == "log"))
    return [exact_lines.exact_lines(panel.data, *windows) for panel in arrangement.panels]


def _nominal(
    results: xr.Dataset, arrangement: Arrangement, given: tuple[float, ...]
) -> tuple[float, float] | None:
    """The point to mark: what was given, or the specification's own values; None out of view."""
    from jaxact.plot.stability_map import place
    from jaxact.sweep import store
    from jaxact.sweep.parameters import of

    axes = [axis for axis in (arrangement.x, arrangement.y) if axis is not None]
    if arrangement.kind == "lines":
        axes = axes[:1]
    if given and len(given) != len(axes):
        shown = " ".join(f"{value:g}" for value in given)
        raise UserError(f"--nominal {shown}: give {' and '.join(axis.name for axis in axes)}")
    own = store.nominal(results)
    if not given and any(axis.name not in own for axis in axes):
        return None
    # The default gains are the reference study's, chosen for its mass.
    usual = any(own[axis.name] == of(axis.name).default for axis in axes if axis.name in _GAINS)
    if not given and usual and own.get("mass") != of("mass").default:
        return None
    point = list(given) or [own[axis.name] for axis in axes]
    if any(math.isnan(value) for value in point):
        return None  # a robot's joints have their own
    if any(place(axis, value) is None for axis, value in zip(axes, point, strict=True)):
        return None
    return point[0], point[-1]


def _pairs(given: tuple[str, ...]) -> dict[str, str]:
    """`name=value` options as a dictionary."""
    pairs = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            raise UserError(f"--select {text}: write it as NAME=VALUE, e.g. delay=0.001")
        pairs[name.strip()] = value.strip()
    return pairs


def _default_output(result: str, kind: str, variable: str, *, usual: bool) -> Path:
    """`stability_map.png` beside the store, or of another than the usual variable its name."""
    from jaxact.sweep.place import is_url
    from jaxact.sweep.store import STORE

    path = Path() / STORE if is_url(result) else Path(result)
    folder = path if (path / STORE).is_dir() else path.parent
    stem = "stability_map" if kind == "map" and usual else f"{variable}_{kind}"
    return folder / f"{stem}.png"
