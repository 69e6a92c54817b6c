"""`jaxact paper`: the study's figures and claims, exact and as simulated."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from jaxact.errors import UserError, nearest, shown

if TYPE_CHECKING:
    from jaxact.paper.results import Results

CLAIMS = "claims.md"


def main(
    *,
    out: Annotated[
        Path, arg(metavar="DIR", help="Folder of the results, made if it is not there.")
    ] = Path("results/paper"),
    format: Annotated[  # noqa: A002 - the option's name
        str, arg(metavar="png|svg|pdf", help="Of the pictures.")
    ] = "png",
    overwrite: Annotated[bool, arg(help="Replace the files of an earlier run.")] = False,
) -> None:
    """Reproduce figures 2, 3 and 4 of the reference study, and judge its claims.

    Neunert, Boaventura, Buchli: "Why off-the-shelf physics simulators fail in evaluating feedback
    controller performance - a case study for quadrupedal robots". Gain margin, phase and delay
    margin, and sensitivity against the actuator's natural frequency [rad/s], for two damping ratios
    and three delays: exact in continuous time, exact when sampled at 1 kHz, and as simulated.
    claims.md says of every claim what is exactly true, and for which cases it holds. Takes about a
    minute.

    examples:
      jaxact paper
      jaxact paper --out figures --format pdf
      jaxact paper --overwrite
    """
    from jaxact.plotting import look

    if format not in look.FORMATS:
        raise UserError(f"--format {shown(format)}; {nearest(format, look.FORMATS)}")
    from jaxact.paper.pictures import PICTURES

    names = [*(f"{name}.{format}" for name in PICTURES), CLAIMS]
    with _destination(out, names, overwrite=overwrite) as folder:
        from jaxact.paper.results import compute

        results = compute()
        _write(results, folder, format)
    print(_summary(results))
    for name in names:
        print(f"wrote {out / name}")


def _write(results: Results, folder: Path, kind: str) -> None:
    from jaxact.paper.pictures import PICTURES
    from jaxact.paper.report import report
    from jaxact.plotting import look

    for name, picture in PICTURES.items():
        look.write(picture(results), folder / f"{name}.{kind}", title=name.replace("_", " "))
    (folder / CLAIMS).write_text(report(results), encoding="utf-8")


def _summary(results: Results) -> str:
    """How many claims hold, and which."""
    from jaxact.paper.claims import claims

    return "\n".join(f"{claim.holds}: {claim.says}" for claim in claims(results))


@contextmanager
def _destination(out: Path, names: list[str], *, overwrite: bool) -> Iterator[Path]:
    """A new folder to write into, whose files go to `out` once the block is done.

    It lies in `out`, so that a forbidden place is found before the work. Whatever ends the block
    with an exception leaves `out` as it was.

    Raises UserError if a file is there that may not be replaced, or `out` cannot be written to.
    """
    there = next((name for name in names if (out / name).exists()), None)
    if there is not None and not overwrite:
        raise UserError(f"output {out / there}: exists; give another --out, or --overwrite")
    made: list[Path] = []
    try:
        for parent in reversed([out, *out.parents]):
            if not parent.exists():
                parent.mkdir()
                made.append(parent)
        with tempfile.TemporaryDirectory(dir=out, prefix=".jaxact-") as folder:
            yield Path(folder)
            for name in names:
                os.replace(Path(folder) / name, out / name)
    except BaseException as error:
        for parent in reversed(made):
            with suppress(OSError):
                parent.rmdir()
        if isinstance(error, OSError):
            reason = error.strerror or error
            raise UserError(
                f"output {out}: cannot be written ({reason}); choose another"
            ) from error
        raise
