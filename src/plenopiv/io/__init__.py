"""Files that a run writes: the velocity field as netCDF and the results folder, whole or not at all."""

from plenopiv.io.netcdf import read_velocity, write_velocity
from plenopiv.io.output import OutputFolder

__all__ = ["OutputFolder", "read_velocity", "write_velocity"]
