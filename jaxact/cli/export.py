"""`jaxact export`: a sweep's results as one NetCDF file, or gains and drives as others' files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

from jaxact.cli import _arguments, _files, _warnings
from jaxact.cli._arguments import option
from jaxact.errors import UserError, shown

_ALL = ".*"


@dataclass(frozen=True)
class Robot:
    """Of a file of gains or a drive, which robot it is for, and what is changed of it."""

    model: Annotated[
        Path | None,
        option("FILE", "MJCF or URDF file: names and order of the joints, limits.", "none"),
    ] = None
    keyframe: _arguments.Keyframe = None
    joints: _arguments.Joints = ()
    damping: _arguments.Damping = None
    gains: _arguments.Gains = None
    set: Annotated[
        UseAppendAction[tuple[str, ...]],
        option(
            "KEY=VALUE",
            "A parameter of the drive, or of some joints: a number, or a range LOW..HIGH that"
            " every environment draws from at its reset: delay=0.002..0.008, kp@.*_knee=30.",
        ),
    ] = ()


def main(
    result: Annotated[
        Positional[str],
        arg(
            metavar="RESULT",
            help="Results of a sweep (folder, its sweep.zarr, or a URL); with --to: gains.toml or"
            " the folder of a tuned robot, a drive of identify, a specification, a model, a file"
            " of gains.",
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
            "Write the gains of a robot in this format; mjlab and isaaclab: where there is a drive"
            " behind them, an actuator in torch.",
            "the results of a sweep as NetCDF",
        ),
    ] = None,
    out: Annotated[Path | None, option("FILE", "With --to: file to write.", "print it")] = None,
    overwrite: Annotated[bool, arg(help="Replace a file of that name.")] = False,
) -> None:
    """Write the results of a sweep as one NetCDF-4 file, or a robot's gains as another's file.

    NetCDF: units and specification included. Gains: kp and kd of every joint with all their digits;
    what the format has no place for stands in a comment and is said. Drives, for mjlab and Isaac
    Lab: one Python file with the drive in torch, an actuator class, and its configuration.

    examples:
      jaxact export results/paper_gain_map map.nc
      jaxact export tuned --to deploy-yaml --model go1.xml --keyframe home --out deploy.yaml
      jaxact export deploy.yaml --to mjcf --model go1.xml
      jaxact export go1.xml --to isaaclab --out go1_gains.py
      jaxact export drive.toml --to mjlab --set kp=35 --set kd=0.5 --out drive.py
      jaxact export go1.xml --to isaaclab --set actuator=starleth --set delay=0.002..0.008
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
    parameters = _parameters(given.pop("set", ()))
    found = export(result, to, target, parameters=parameters, overwrite=overwrite, **given)
    for one in found.lost:
        _warnings.warn(one)
    if target is None:
        print(found.text, end="")
    else:
        what = "drives" if "DriveActuator" in found.text else "gains"
        print(f"{target}: {what} of {len(found.joints.names)} joints")


def _parameters(changes: tuple[str, ...]) -> dict[str, Any]:
    """The parameters of --set: numbers, ranges, names, and tables of patterns of joints."""
    tables: dict[str, dict[str, Any]] = {}
    for change in changes:
        key, equals, text = (part.strip() for part in change.partition("="))
        if not equals or not key or not text:
            raise UserError(f"--set {shown(change)}: write it as key=value, e.g. kp=400")
        try:
            numbers = tuple(float(part) for part in text.split(".."))
        except ValueError:
            numbers = ()
        value = numbers if len(numbers) == 2 else numbers[0] if len(numbers) == 1 else text
        name, _, pattern = key.partition("@")
        pattern = pattern or _ALL
        # as of specifications: the last counts, and one for all joints drops those of some
        before = {} if pattern == _ALL else tables.get(name, {})
        before.pop(pattern, None)
        tables[name] = {**before, pattern: value}
    return {
        name: table[_ALL] if [*table] == [_ALL] else table for name, table in tables.items()
    }  # fmt: skip


def _netcdf(result: str, file: Path, *, overwrite: bool) -> None:
    from jaxact.sweeping import opening

    _files.check_output(file, ".nc", overwrite=overwrite)
    _warnings.older(result)
    opening.to_netcdf(opening.load_result(result), file, overwrite=overwrite)
    print(f"{file}: {file.stat().st_size:,} bytes")
