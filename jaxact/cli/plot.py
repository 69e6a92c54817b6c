"""`jaxact plot`: pictures of a sweep's results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from jaxact.cli import _warnings
from jaxact.cli._arguments import option
from jaxact.errors import UserError


@dataclass(frozen=True)
class Layout:
    """What is drawn, and over which parameters."""

    x: Annotated[
        str | None, option("NAME", "Parameter along x.", "kp where it was swept, else the first")
    ] = None
    y: Annotated[
        str | None,
        option(
            "NAME",
            "Parameter along y (of --kind lines: a curve for each value).",
            "kd where it was swept, else the second",
        ),
    ] = None
    facet: Annotated[
        tuple[str, ...],
        option(
            "NAME",
            "One panel for each value: one parameter, or two for rows and columns.",
            "what is left over",
        ),
    ] = ()
    select: Annotated[
        UseAppendAction[tuple[str, ...]],
        option(
            "NAME=VALUE",
            "Keep only the nearest value of a parameter, in its SI unit (delay in s); one outside"
            " its axis is refused. Can be repeated.",
        ),
    ] = ()
    variable: Annotated[
        str | None,
        option(
            "NAME",
            "Result to colour, e.g. overshoot, settling_time, peak_force.",
            "growth_rate; shaking_rate where robots topple",
        ),
    ] = None
    kind: Annotated[
        str | None,
        option(
            "map|scatter|lines",
            "What to draw.",
            "map for a grid, scatter for a random sample, lines for a single axis",
        ),
    ] = None
    nominal: Annotated[
        tuple[float, ...],
        option("X Y", "Point to mark.", "the specification's own parameters"),
    ] = ()


def main(
    result: Annotated[
        Positional[str],
        arg(metavar="RESULT", help="Results folder of a sweep, or the store in it; path or URL."),
    ],
    layout: Layout,
    *,
    title: Annotated[
        str | None, option("TEXT", "Above the picture.", "the sweep's description")
    ] = None,
    out: Annotated[
        Path | None,
        option(
            "FILE",
            "Picture to write: .png, .svg or .pdf; one that is there is replaced.",
            "stability_map.png in the results folder",
        ),
    ] = None,
    quick: Annotated[
        bool, arg(help="Leave out the comparison of every verdict with exact theory.")
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
    from jaxact.plotting import field, theme
    from jaxact.sweeping import opening
    from jaxact.verbs import map_pictures

    if out is not None:
        theme.check_output(out)
    _warnings.older(result)
    wanted = {"verdict", layout.variable} if layout.variable else {"verdict", *field.RATES}
    results = opening.load_result(result, wanted)
    how = vars(layout) | {"select": _pairs(layout.select)}
    figure, said, kind = map_pictures.page(results, **how, title=title, compare=not quick)
    usual = field.usual(results)
    shown = layout.variable or usual
    path = _default_output(result, kind, shown, usual=shown == usual) if out is None else out
    theme.write(figure, path, title=f"jaxact: {shown}")
    print(said)
    print(f"wrote {path}")


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
    from jaxact.sweeping.location import is_url
    from jaxact.sweeping.store import STORE

    path = Path() / STORE if is_url(result) else Path(result)
    folder = path if (path / STORE).is_dir() else path.parent
    stem = "stability_map" if kind == "map" and usual else f"{variable}_{kind}"
    return folder / f"{stem}.png"
