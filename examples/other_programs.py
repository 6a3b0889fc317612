"""A measured field for other programs: ParaView and PyVista, OpenPIV, and a plain table.

    python examples/other_programs.py [FOLDER]

Reads FOLDER/results/velocity.nc, where FOLDER, "ring" by default, is one that examples/vortex_ring.py made, or yours.
Writes FOLDER/velocity.vtkhdf (all vectors), FOLDER/plane.txt (the middle plane of vectors, as OpenPIV's tools read
it) and FOLDER/vectors.csv (what was measured, one vector a line), and prints what is in them.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

from plenopiv.io import read_velocity
from plenopiv.io.openpiv import as_openpiv, write_openpiv
from plenopiv.io.vtkhdf import write_vtkhdf

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "ring")
velocity = read_velocity(folder / "results" / "velocity.nc")  # dims (time, z, y, x); mm and m/s

write_vtkhdf(folder / "velocity.vtkhdf", velocity)  # ParaView: File > Open; PyVista: pyvista.get_reader
axes = ("time, " if velocity.sizes["time"] > 1 else "") + "z, y, x"
with h5py.File(folder / "velocity.vtkhdf") as file:
    for name, values in file["VTKHDF/PointData"].items():
        print(f"velocity.vtkhdf  {name:12} {values.shape} ({axes}, component)")

z = float(velocity.z[velocity.sizes["z"] // 2])
write_openpiv(folder / "plane.txt", velocity, z_mm=z)
plane = as_openpiv(velocity, z_mm=z)  # the same as arrays, rows from above, y and v upward
replaced = int((plane.flags == 2).sum())
seen = f"{replaced} replaced, {int(plane.mask.sum())} seen by no view"
print(f"plane.txt        {plane.u.shape} (rows, columns) at z = {z:g} mm, {seen}")

names = ["u", "v", "w", "u_std", "v_std", "w_std"]
table = velocity.isel(time=0)[[*names, "valid"]].to_dataframe().reset_index()
measured = table[table.valid == 1][["x", "y", "z", *names]]
np.savetxt(folder / "vectors.csv", measured, fmt="%.6g", delimiter=",", header=",".join(measured.columns), comments="")
print(f"vectors.csv      {len(measured)} vectors: {', '.join(measured.columns)} (mm, m/s)")
