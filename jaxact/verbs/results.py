"""Datasets that sweeps and simulations give, opened again, drawn in a notebook and reported.

They are plain datasets of xarray. What is jaxact's own stands behind the accessor `run.jaxact`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import xarray as xr

from jaxact.reportable import Reportable
from jaxact.sweeping.opening import load_result, loaded, open_result, opened
from jaxact.sweeping.summary import summary
from jaxact.verbs import notebook

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxact.reportable import Report

__all__ = ["Results", "dataset", "load_result", "loaded", "open_result", "opened"]


@xr.register_dataset_accessor("jaxact")
class Results(Reportable):
    """What a dataset of `jaxact.sweep` or `jaxact.simulate` can do by itself.

        maps.jaxact                      # as the last line of a cell: shares of verdicts, the map
        maps.jaxact.report("map.html")   # an HTML file that one can click

    Attributes:
        dataset: that it belongs to.
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = dataset

    def report(
        self, out: str | os.PathLike[str] = "report.html", *, title: str = "", command: str = ""
    ) -> Report:
        """Write a report, as `jaxact.report(dataset, out)`; see there."""
        from jaxact.verbs.report import report  # which opens results too

        return report(self.dataset, out, title=title, command=command)

    def __repr__(self) -> str:
        """How many loops have which verdict, or the table of a single simulated loop."""
        single = self.dataset.attrs.get("report")
        if single is not None:
            return single
        return summary(self.dataset) if "verdict" in self.dataset else repr(self.dataset)

    def _repr_html_(self) -> str:
        words = "a simulated loop" if "time" in self.dataset.dims else "results of a sweep"
        return notebook.shown(repr(self), self._picture, words=words)

    def _picture(self) -> Figure:
        from jaxact.verbs import map_pictures

        if "time" in self.dataset.dims:
            return notebook.simulated(self.dataset)
        return map_pictures.page(self.dataset)[0]


def dataset(
    variables: Mapping[str, Any], coords: Mapping[str, Any], attributes: Mapping[str, Any]
) -> xr.Dataset:
    """A dataset of ours, which has `.jaxact`."""
    return xr.Dataset(variables, coords, attributes)
