"""`jaxact export`: the results of a sweep as one NetCDF file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from jaxact.cli import _warnings


def main(
    result: Annotated[
        Positional[str],
        arg(metavar="RESULT", help="Results folder of a sweep, or its sweep.zarr; path or URL."),
    ],
    file: Annotated[
        Positional[Path], arg(metavar="FILE", help="NetCDF file to write, e.g. map.nc.")
    ],
    *,
    overwrite: Annotated[bool, arg(help="Replace a file of that name.")] = False,
) -> None:
    """Write the results of a sweep as one NetCDF-4 file, units and specification included.

    examples:
      jaxact export results/paper_gain_map map.nc
    """
    from jaxact.sweeping import opening

    opening.check_netcdf(file, overwrite=overwrite)
    _warnings.older(result)
    opening.to_netcdf(opening.load_result(result), file, overwrite=overwrite)
    print(f"{file}: {file.stat().st_size:,} bytes")
