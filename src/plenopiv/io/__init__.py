"""Files that a run writes, whole or not at all: velocity as netCDF, for ParaView and OpenPIV; the results folder."""

from plenopiv.io.netcdf import read_velocity, write_velocity
from plenopiv.io.output import OutputFolder

__all__ = ["OutputFolder", "read_velocity", "write_velocity"]
