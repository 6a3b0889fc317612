"""A vortex ring, simulated, measured and drawn beside the truth.

    python examples/vortex_ring.py [FOLDER] [--columns 1000] [--rows 800]

Writes a recording (images, experiment.toml, the truth) into FOLDER, "ring" by default, runs it, and draws the plane
through the ring's axis into FOLDER/vortex_ring.png. Prints the errors in voxels, by depth too. The other examples
read what this one leaves in FOLDER.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import plenopiv
from plenopiv.accuracy import score_velocity
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.design.advice import suggested
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

DT_S = 0.0005
RING = flow("vortex-ring", circulation_mm2_s=600.0, radius_mm=1.4, core_radius_mm=0.8, axis="x")

words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
words.add_argument("folder", nargs="?", type=Path, default=Path("ring"))
words.add_argument("--columns", type=int, default=1000, help="of the camera's sensor")
words.add_argument("--rows", type=int, default=800)
chosen = words.parse_args()

# f = 50 mm, aperture 25 mm, M = -1; microlenses 0.077 mm apart, turned by 0.002 rad; 5.5 um pixels, 12 bits
camera = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
    0.308,
    Sensor(chosen.columns, chosen.rows, 0.0055, bit_depth=12, black_level=60),
)
volume_mm = suggested(camera, depth_mm=(-3.0, 3.0)).limits_mm  # what every view sees
windows = ((64, 64, 24), (48, 48, 16))  # voxels along x, y, z, coarse to fine
made = simulate_recording(chosen.folder, camera, RING, dt_s=DT_S, volume_mm=volume_mm, windows=windows, overwrite=True)

experiment = plenopiv.load(made.directory / "experiment.toml")
result = plenopiv.process(experiment, overwrite=True)  # velocity.nc and report.html in FOLDER/results

particles, voxel_mm = (made.a.position_mm, made.b.position_mm), experiment.volume.voxel_mm
score = score_velocity(result.velocity, *particles, camera, dt_s=DT_S, voxel_mm=voxel_mm, window_voxels=windows[-1])
print(f"{score.vectors} vectors judged, {score.particles_per_window:.0f} particles in a window")
print("RMS error along x, y, z (voxel):", *(f"{error:.3f}" for error in score.final.rms))
for band in score.final.by_depth:
    print(f"  |z| {band.from_mm:.1f} to {band.to_mm:.1f} mm:", *(f"{error:.3f}" for error in band.rms))

plane = result.velocity.isel(time=0).sel(y=0.0, method="nearest")
x, z = np.meshgrid(plane.x, plane.z)
true_u, _, true_w = RING(np.stack([x, np.full_like(x, plane.y), z], -1).reshape(-1, 3)).T.reshape(3, *x.shape)
figure = Figure(figsize=(9.0, 4.5), layout="constrained")
for axes, name, u, w in zip(
    figure.subplots(1, 2, sharey=True), ("measured", "true"), (plane.u, true_u), (plane.w, true_w), strict=True
):
    limit = float(np.abs(true_u).max())
    colour = axes.pcolormesh(x, z, u, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest", alpha=0.6)
    axes.quiver(x, z, u, w, angles="xy")
    axes.set(title=f"{name}, y = {float(plane.y):.2f} mm", xlabel="x (mm)", ylabel="z (mm), toward the camera")
figure.colorbar(colour, label="u (m/s)")
figure.savefig(chosen.folder / "vortex_ring.png", dpi=120)
print("drawn:", chosen.folder / "vortex_ring.png")
