"""The chain of a run, one stage after the other, with the shape and unit of what passes from each to the next.

    python examples/stage_by_stage.py [FOLDER]

FOLDER, "ring" by default, holds an experiment.toml and its images: one that examples/vortex_ring.py made, or yours.
Prints a line for each stage and writes FOLDER/stage_by_stage.nc, the same vectors as in velocity.nc of a run.
"""

import sys
from pathlib import Path

import plenopiv
from plenopiv.calibration import find_lattice
from plenopiv.chain import Chain
from plenopiv.io import write_velocity
from plenopiv.lightfield import decode, layout
from plenopiv.reconstruction.noise import counts_per_electron

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "ring")
experiment = plenopiv.load(folder / "experiment.toml")

recording = experiment.recording()  # frames and white image, their headers checked
frames, white = [recording.frame(k) for k in (0, 1)], recording.white()
assert white is not None, "this script finds the microlenses in a white image"
print(f"recording      {len(recording)} frames, {white.shape} (rows, columns), {white.dtype} counts, upright")

fit = find_lattice(white, experiment.camera())
camera = experiment.camera().with_lattice(fit.lattice)
print(f"calibration    {fit.microlenses} microlenses, {fit.residual_px:.3f} px off the fitted lattice (RMS)")

where = layout(camera)  # which pixel is which view's of which microlens; nothing is interpolated
field = decode(frames[0], where)
print(f"light field    {field.values.shape} (view, lens), {field.values.dtype} counts above the black level")

chain = Chain(  # plain data: what does not change from frame to frame
    cameras=(camera,),
    grid=experiment.grid(),
    reconstruction=experiment.reconstruction.settings(),
    correlation=experiment.correlation.settings(),
    counts_per_electron=counts_per_electron(decode(white, where)),
)
found = [chain.reconstruct([frame]) for frame in frames]  # candidates, then MART; weights are never stored
volume, grid = found[0].volume, chain.grid
print(f"reconstruction {grid.shape} (z, y, x) voxels of {grid.voxel_mm} mm, {100 * volume.occupancy:.2f} % hold light")
print("               residual by iteration, counts:", *(f"{counts:.1f}" for counts in found[0].residuals))

displacement = chain.displacement(found[0].volume, found[1].volume)  # planes near focus count less
print(f"displacement   {displacement.displacement.shape} (component x y z, z, y, x), voxels per frame")

velocity = chain.dataset(displacement, recording.dt_s, time_s=0.5 * recording.dt_s)
write_velocity(folder / "stage_by_stage.nc", velocity)
print(f"velocity       {dict(velocity.sizes)}: {', '.join(map(str, velocity.data_vars))}")
print("written:", folder / "stage_by_stage.nc")
