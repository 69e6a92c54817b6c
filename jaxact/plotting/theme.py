"""The shared look of every picture: colours, type, and how a file is written."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.colors import Colormap, LinearSegmentedColormap, to_hex, to_rgb
from matplotlib.figure import Figure

from jaxact import files
from jaxact.errors import UserError

FORMATS = ("png", "svg", "pdf")

# Okabe and Ito's palette: distinguishable with every common colour deficiency.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
DASHES = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 1.5, 1.5, 1.5)), (0, (8, 2, 1.5, 2, 1.5, 2)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
INK = "#333333"
FAINT = "#8A8A8A"
SMALL_PRINT = "#5C5C5C"
GRID = "#D9D9D9"

# rc parameters of every jaxact picture. Applied with `applied()`, never globally.
RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.direction": "out",
    "ytick.direction": "out",
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "hatch.linewidth": 0.5,
    "figure.dpi": 100.0,
    "savefig.dpi": 170.0,
    "svg.hashsalt": "jaxact",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}


@contextlib.contextmanager
def applied() -> Iterator[None]:
    """Draw with jaxact's look inside the block, and leave matplotlib's settings as they were."""
    with matplotlib.rc_context(RC):
        yield


def diverging() -> Colormap:
    """The map of the growth rate: blue (decays) through white (zero) to brown-red (grows).

    Lightness falls evenly in either direction, and further on the growing side, so that the two
    ends stay apart in grey as well.
    """
    stops = [
        (0.00, "#0B3C7D"), (0.15, "#2A6BB0"), (0.32, "#6FA8D6"), (0.45, "#C6DEEF"),
        (0.50, "#FAFAF7"),
        (0.55, "#FBDCC0"), (0.68, "#EE9A58"), (0.85, "#B8501B"), (1.00, "#5E1A06"),
    ]  # fmt: skip
    return LinearSegmentedColormap.from_list("jaxact_diverging", stops)


def sequential() -> Colormap:
    """The map of every other result: pale (low) to blue-green (high), light enough for hatches."""
    stops = ["#FFFDE0", "#D9EFC0", "#9AD6BF", "#5CBAC6", "#3D94BF", "#3568A8"]
    return LinearSegmentedColormap.from_list("jaxact_sequential", stops)


def style(index: int) -> dict[str, object]:
    """Colour and dash of the index-th line, so that lines differ in grey as well."""
    return {"color": CYCLE[index % len(CYCLE)], "linestyle": DASHES[index % len(DASHES)]}


def shade(color: str, share: float) -> str:
    """A colour of the same hue: lighter by a share up to 1, or darker by one down to -1."""
    end = 1.0 if share > 0.0 else 0.0
    return to_hex([part + abs(share) * (end - part) for part in to_rgb(color)])


def check_output(path: Path) -> Path:
    """The path of a picture to be written, if it can be.

    Raises:
        UserError: a format that is not one of FORMATS, and a folder that is not there.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        said = f"'.{suffix}' is not a picture format" if suffix else "the name has no ending"
        raise UserError(f"output {path}: {said}; use .png, .svg or .pdf")
    files.check_output(path)
    return path


def write(figure: Figure, path: Path, *, title: str) -> None:
    """Write the figure as PNG, SVG or PDF, by the path's ending, whole or not at all.

    The same figure gives the same file: no date is stored. An existing file is replaced.

    Raises:
        UserError: as `check_output`, or the folder cannot be written to.
    """
    check_output(path)
    kind = path.suffix.lower().lstrip(".")
    metadata: dict[str, str | None] = {"Title": title}
    metadata |= {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(
        kind, {"Software": "jaxact"}
    )
    with applied(), files.output(path) as partial:
        figure.savefig(partial, format=kind, metadata=metadata, facecolor="white")
