"""`jaxact identify`: from logs of the real thing to the drive's numbers."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import OmitArgPrefixes, Positional, arg

from jaxact import files
from jaxact.cli import _design, _reports
from jaxact.cli._design import Bench
from jaxact.errors import UserError
from jaxact.parameters import CONTROL_RATE

if TYPE_CHECKING:
    from jaxact.identification.result import Identified
    from jaxact.identification.robot import IdentifiedRobot


Logs = Annotated[
    Positional[tuple[Path, ...]], arg(metavar="LOG ...", help="CSV or NPZ files to fit.")
]
Map = Annotated[
    Path | None,
    arg(metavar="TOML", help="What the columns are; see the documentation."),
]
Plant = Annotated[
    str,
    arg(
        metavar="none|mass|pendulum|MODEL",
        help="What the drive moves; none: its force was measured; or a robot's MJCF or URDF file.",
    ),
]
Groups = Annotated[
    str,
    arg(
        metavar="PATTERN,...",
        help="Regular expressions found in the names of a robot's joints; those of one share a"
        " drive.",
    ),
]
Validate = Annotated[
    tuple[Path, ...],
    arg(metavar="LOG ...", help="Logs to try the models on; otherwise the end of each log."),
]
JointName = Annotated[str, arg(metavar="NAME", help="Of several joints in the map.")]
ControlRate = Annotated[
    float | None,
    arg(metavar="HZ", help="Of the drive's own controller [Hz]; otherwise once a row."),
]
Loss = Annotated[
    str, arg(metavar="linear|soft_l1|huber", help="Of the least squares; others bear outliers.")
]
Method = Annotated[
    str, arg(metavar="trf|adam", help="trf: all logs at once; adam: a few at a time, for dozens.")
]
Bootstrap = Annotated[
    bool, arg(help="Intervals by resampling blocks of rows, a check of the usual ones.")
]
Design = Annotated[
    bool, arg(help="Say which excitation would identify what, and write the best as CSV.")
]
Out = Annotated[
    Path | None,
    arg(
        metavar="FILE",
        help="Where the drive goes, with a picture beside it (drive.toml); with --design the"
        " excitation (excitation.csv).",
    ),
]
Report = Annotated[
    Path | None,
    arg(metavar="FILE", help="HTML file with all of it, to click; one that is there is replaced."),
]
Overwrite = Annotated[bool, arg(help="Replace what is there.")]
Quiet = Annotated[bool, arg(help="Show no progress.")]


def main(
    logs: Logs = (),
    bench: Annotated[Bench, OmitArgPrefixes] = Bench(),  # noqa: B008
    *,
    design: Design = False,
    map: Map = None,
    plant: Plant = "none",
    validate: Validate = (),
    joint: JointName = "",
    groups: Groups = "",
    control_rate: ControlRate = None,
    loss: Loss = "linear",
    method: Method = "trf",
    bootstrap: Bootstrap = False,
    out: Out = None,
    report: Report = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Identify a drive from logs: its dynamics, delay, friction, and how well each is known.

    A ladder of models, from a mere gain to second order with delay and from no friction to one
    that grows with the load, is fitted to the logs on their own time stamps. The simplest one that
    predicts other logs as well as the best, and all of whose numbers the logs can tell, is chosen.

    With a robot's model as --plant: logs of its joints together, of the robot in the air or on a
    bench, the map with a table or a name for each joint. Links and gravity are the model's; of each
    joint's drive armature, friction, delay and dynamics are identified.

    examples:
      jaxact identify bench.csv --map columns.toml --validate other.csv
      jaxact identify bench.csv --map columns.toml --report bench.html
      jaxact identify swing.csv --map columns.toml --plant pendulum --control-rate 1000
      jaxact identify air.csv --map columns.toml --plant robot.xml --groups hip,knee
      jaxact identify --design --wn 100..1000 --delay 0..5e-3 --duration 20
    """
    out = out or Path("excitation.csv" if design else "drive.toml")
    picture = out.with_suffix(".png")
    _check_outputs([out] if design else [out, picture], overwrite=overwrite)
    told: dict[str, Any] = {
        "validate": validate, "joint": joint, "groups": groups,
        CONTROL_RATE: control_rate, "loss": loss, "method": method, "bootstrap": bootstrap,
    }  # fmt: skip
    if design:
        _demand_no_logs({"map": map, "report": report, **told})
        if logs:
            raise UserError(f"--design needs no logs; leave {logs[0]} out, or --design")
        _design.run(bench, plant, out)
        return
    if not logs:
        raise UserError("no logs; give the CSV or NPZ files to fit, or --design")
    _design.refuse(bench)
    if report is not None:
        _reports.check_output(report)

    from jaxact.cli import _progress
    from jaxact.verbs.identify import identify

    told["groups"] = groups.split(",") if groups else ()
    with _progress.phases(quiet=quiet) as progress:
        found = identify(
            logs, plant, columns=map, **told, progress=lambda name: progress(f"fitting: {name}")
        )
    _write(found, out, picture)
    print(found)
    print(f"wrote {out}")
    print(f"wrote {picture}")
    if report is not None:
        _reports.write(found, report)


def _demand_no_logs(given: Mapping[str, Any]) -> None:
    """Raise UserError where one of these options, which are of logs, is not as by default."""
    usual = inspect.signature(main).parameters
    for name, value in given.items():
        if value != usual[name].default:
            raise UserError(f"`{name}` is of logs, not of `design`; leave one of them out")


def _check_outputs(paths: list[Path], *, overwrite: bool) -> None:
    """Raise UserError where a file cannot be written, or is there already."""
    if len(set(paths)) < len(paths):
        raise UserError(f"output {paths[0]}: the picture has this name; give --out drive.toml")
    for path in paths:
        files.check_output(path, overwrite=overwrite)


def _write(found: Identified | IdentifiedRobot, out: Path, picture: Path) -> None:
    """The drive as TOML, and its picture."""
    from jaxact.identification.result import Identified
    from jaxact.loops import toml
    from jaxact.plotting import theme
    from jaxact.verbs.identify import identification_sheet, robot_sheet

    one = isinstance(found, Identified)
    figure = identification_sheet(found) if one else robot_sheet(found)
    said = found.verdict.sentence if one else found.sentence
    text = f"# Identified by jaxact identify: {said}\n\n"
    with files.output(out) as partial:
        partial.write_text(text + toml.dumps(found.document()), encoding="utf-8")
    theme.write(figure, picture, title="jaxact identify")
