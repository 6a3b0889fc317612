"""One frame as a light field: three views through the main lens, and three depths in focus, before any reconstruction.

    python examples/views_and_refocusing.py [FOLDER]

FOLDER, "ring" by default, holds an experiment.toml and its images: one that examples/vortex_ring.py made, or yours.
Draws FOLDER/views_and_refocusing.png: above, particles move from view to view, those nearer to the camera than the
focal plane the other way than those beyond it; below, they are sharp at their own depth. Prints shapes and units.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import plenopiv
from plenopiv.calibration import find_lattice
from plenopiv.lightfield import decode, layout
from plenopiv.refocusing import image_axes, refocused, sub_aperture

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "ring")
experiment = plenopiv.load(folder / "experiment.toml")
recording = experiment.recording()
white = recording.white()
assert white is not None, "this script finds the microlenses in a white image"
camera = experiment.camera().with_lattice(find_lattice(white, experiment.camera()).lattice)
lightfield = decode(recording.frame(0), layout(camera))

x_mm, y_mm = image_axes(camera)  # x rising, y falling: row 0 is on top
offsets = lightfield.layout.offsets  # (view, 2): pixels to the right and down of the micro-image's centre
reach = int(0.7 * camera.aperture_radius_px)
print(f"{len(offsets)} views; one pixel looks through {camera.portion_mm:.2f} mm of the main lens")
pictures = {}
for m in (-reach, 0, reach):
    view = int(np.flatnonzero((offsets == (m, 0)).all(1))[0])
    pictures[f"through u = {m * camera.portion_mm:+.1f} mm"] = sub_aperture(lightfield, view, x_mm, y_mm)
lo, hi = experiment.volume.z_mm
for z in (0.5 * lo, 0.0, 0.5 * hi):
    pictures[f"refocused at z = {z:+.2f} mm"] = refocused(lightfield, z, x_mm, y_mm)
print(f"pictures of {y_mm.size} x {x_mm.size} (y, x), {abs(x_mm[1] - x_mm[0]):.3f} mm a pixel, in counts")

figure = Figure(figsize=(11.0, 7.0), layout="constrained")
for axes, (words, picture) in zip(figure.subplots(2, 3).flat, pictures.items(), strict=True):
    extent = (x_mm[0], x_mm[-1], y_mm[-1], y_mm[0])
    axes.imshow(picture, cmap="gray", vmin=0.0, vmax=float(np.nanpercentile(picture, 99.5)), extent=extent)
    axes.set(title=words, xlabel="x (mm)", ylabel="y (mm)")
figure.savefig(folder / "views_and_refocusing.png", dpi=120)
print("drawn:", folder / "views_and_refocusing.png")
