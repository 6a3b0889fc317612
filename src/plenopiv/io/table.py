"""A velocity field as a table (CSV): one vector a line, for pandas, R, Origin or a spreadsheet.

The first line names the columns with their units, ``u_m_s`` is u in m/s. Numbers are written so that they are read
back as the same. A cell is empty where there is no number (no view sees it, or it lies in a body).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from plenopiv.errors import printable
from plenopiv.io.aside import written_aside
from plenopiv.io.fields import DIMS, units_of, variables_of, variables_of_time

if TYPE_CHECKING:
    import xarray

SUFFIX = {
    "m s-1": "_m_s",
    "m2 s-2": "_m2_s2",
    "s-1": "_1_s",
    "s-2": "_1_s2",
    "mm": "_mm",
    "s": "_s",
    "degree": "_degree",
}


def as_table(dataset: xarray.Dataset) -> Any:
    """A pandas table with a row for each vector of a velocity field (``io.read_velocity``), x fastest, then y,
    z, time; units in the names of columns.

    Columns: ``time_s, x_mm, y_mm, z_mm``, then the variables: ``u_m_s``, ..., ``valid``, ``peak_ratio``, and what
    there is of a time alone (``phase_degree``, ``pairs`` of ensembles).
    """
    names = variables_of(dataset) + variables_of_time(dataset)
    table = dataset[names].to_dataframe(dim_order=list(DIMS)).reset_index()
    named = {name: printable(name) + SUFFIX.get(units_of(dataset[name]), "") for name in names}
    named |= {"time": "time_s", "x": "x_mm", "y": "y_mm", "z": "z_mm"}
    return table[["time", "x", "y", "z", *names]].rename(columns=named)


def write_table(path: str | Path, dataset: xarray.Dataset) -> None:
    """Write that table as CSV, one time after the other.

    Raises:
        PlenoPIVError: the file cannot be written; nothing is left behind.
    """
    with written_aside(path) as aside, aside.open("w", encoding="utf-8", newline="") as file:
        for k in range(dataset.sizes["time"]):
            as_table(dataset.isel(time=[k])).to_csv(file, index=False, header=k == 0, lineterminator="\n")
