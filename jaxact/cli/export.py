"""`jaxact export`: a sweep's results as one NetCDF file, or gains in other people's formats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from jaxact import files
from jaxact.cli import _arguments, _warnings
from jaxact.cli._arguments import option
from jaxact.errors import UserError


@dataclass(frozen=True)
class Robot:
    """Of a file of gains, which robot they are for."""

    model: Annotated[
        Path | None,
        option("FILE", "MJCF or URDF file: names and order of the joints, limits.", "none"),
    ] = None
    keyframe: _arguments.Keyframe = None
    joints: _arguments.Joints = ()
    damping: _arguments.Damping = None


def main(
    result: Annotated[
        Positional[str],
        arg(
            metavar="RESULT",
            help="Results of a sweep (folder, its sweep.zarr, or a URL); with --to: gains.toml or"
            " the folder of a tuned robot, a specification with a [plant], a model, a file of"
            " gains.",
        ),
    ],
    robot: Robot,
    file: Annotated[
        Positional[Path | None],
        arg(metavar="FILE", help="NetCDF file to write, e.g. map.nc; with --to as --out."),
    ] = None,
    *,
    to: Annotated[
        str | None,
        option(
            "toml|mjcf|deploy-yaml|rl-gym|legged-gym|isaaclab|mjlab",
            "Write the gains of a robot in this format.",
            "the results of a sweep as NetCDF",
        ),
    ] = None,
    out: Annotated[Path | None, option("FILE", "With --to: file to write.", "print it")] = None,
    overwrite: Annotated[bool, arg(help="Replace a file of that name.")] = False,
) -> None:
    """Write the results of a sweep as one NetCDF-4 file, or a robot's gains as another's file.

    NetCDF: units and specification included. Gains: kp and kd of every joint with all their digits;
    what the format has no place for stands in a comment and is said.

    examples:
      jaxact export results/paper_gain_map map.nc
      jaxact export tuned --to deploy-yaml --model go1.xml --keyframe home --out deploy.yaml
      jaxact export deploy.yaml --to mjcf --model go1.xml
      jaxact export go1.xml --to isaaclab --out go1_gains.py
    """
    given = {name: value for name, value in vars(robot).items() if value not in (None, ())}
    if to is None:
        for name in ("out", *given):
            if name in given or (name == "out" and out is not None):
                raise UserError(f"{_arguments.typed(name)}: is for gains; give --to as well")
        if file is None:
            raise UserError("give FILE, the NetCDF file to write, or a format of gains with --to")
        _netcdf(result, file, overwrite=overwrite)
        return
    if file is not None and out is not None:
        raise UserError(f"give one file to write, {file} or --out {out}")
    from jaxact.verbs.export import export

    target = out if out is not None else file
    found = export(result, to, target, overwrite=overwrite, **given)
    for one in found.lost:
        _warnings.warn(one)
    if target is None:
        print(found.text, end="")
    else:
        print(f"{target}: gains of {len(found.joints.names)} joints")


def _netcdf(result: str, file: Path, *, overwrite: bool) -> None:
    from jaxact.sweeping import opening

    files.check_output(file, overwrite=overwrite)
    _warnings.older(result)
    opening.to_netcdf(opening.load_result(result), file, overwrite=overwrite)
    print(f"{file}: {file.stat().st_size:,} bytes")
