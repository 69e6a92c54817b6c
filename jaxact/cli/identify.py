"""`jaxact identify`: from logs of the real thing to the drive's numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from jaxact.errors import UserError


def main(
    logs: Annotated[
        Positional[tuple[Path, ...]], arg(metavar="LOG ...", help="CSV or NPZ files to fit.")
    ],
    *,
    columns: Annotated[
        Path | None,
        arg(name="map", metavar="TOML", help="What the columns are; see the documentation."),
    ] = None,
    plant: Annotated[
        str,
        arg(
            metavar="none|mass|pendulum",
            help="What the drive moves; none: its force was measured.",
        ),
    ] = "none",
    validate: Annotated[
        tuple[Path, ...],
        arg(metavar="LOG ...", help="Logs to try the models on; otherwise the end of each log."),
    ] = (),
    joint: Annotated[str, arg(metavar="NAME", help="Of several joints in the map.")] = "",
    control_rate: Annotated[
        float | None,
        arg(metavar="HZ", help="Of the drive's own controller [Hz]; otherwise once a row."),
    ] = None,
    loss: Annotated[
        str,
        arg(metavar="linear|soft_l1|huber", help="Of the least squares; the others bear outliers."),
    ] = "linear",
    bootstrap: Annotated[
        bool, arg(help="Intervals by resampling blocks of rows, a check of the usual ones.")
    ] = False,
    out: Annotated[
        Path, arg(metavar="TOML", help="Where the drive goes; a picture beside it.")
    ] = Path("drive.toml"),
    overwrite: Annotated[bool, arg(help="Replace what is there.")] = False,
    quiet: Annotated[bool, arg(help="Show no progress.")] = False,
) -> None:
    """Identify a drive from logs: its dynamics, delay, friction, and how well each is known.

    A ladder of models, from a mere gain to second order with delay and from no friction to one
    that grows with the load, is fitted to the logs on their own time stamps. The simplest one that
    predicts other logs as well as the best, and all of whose numbers the logs can tell, is chosen.

    examples:
      jaxact identify bench.csv --map columns.toml --validate other.csv
      jaxact identify swing.csv --map columns.toml --plant pendulum --control-rate 1000
    """
    picture = out.with_suffix(".png")
    for path in (out, picture):
        if path.exists() and not overwrite:
            raise UserError(f"output {path}: exists; give another --out, or --overwrite")
    if not out.parent.is_dir():
        raise UserError(f"output {out}: the folder {out.parent} does not exist; create it first")

    from jaxact import files
    from jaxact.cli import _progress
    from jaxact.loops import toml
    from jaxact.plotting import theme
    from jaxact.verbs.identify import identification_sheet, identify

    with _progress.phases(quiet=quiet) as progress:
        found = identify(
            logs, plant, validate=validate, columns=columns, joint=joint,
            control_rate=control_rate, loss=loss, bootstrap=bootstrap,
            progress=lambda name: progress(f"fitting: {name}"),
        )  # fmt: skip
    figure = identification_sheet(found)
    text = f"# Identified by jaxact identify: {found.verdict.sentence}\n\n"
    with files.output(out) as partial:
        partial.write_text(text + toml.dumps(found.document()), encoding="utf-8")
    theme.write(figure, picture, title="jaxact identify")
    print(found.report)
    print(f"wrote {out}")
    print(f"wrote {picture}")
