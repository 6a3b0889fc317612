"""The snapshot that is shipped, and what is known of its resolution.

python paper/jet/snapshot.py build/jet/192x128x128/state-008.0.npz

writes src/plenopiv/simulation/jet.nc (m/s on mm, the solver's grid and whole periodic box, whole numbers of STEP_M_S)
and paper/jet/resolution.json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import xarray

from plenopiv.simulation.file_grid import FileGrid
from plenopiv.simulation.gridded import GriddedVelocity
from plenopiv.simulation.netcdf_grid import read_netcdf

ROOT = Path(__file__).parents[2]
D_MM, NU_MM2_S = 6.0, 1.0  # nozzle's diameter (the paper); water, which the paper does not state
STEP_M_S = 1e-4  # of the stored velocities, 1/4170 of U
BAND = 4.0  # of the spectrum, in 1/D
POINTS = 50_000  # at which the sampler's divergence is measured


def wavenumbers(shape, box):
    """kx, ky, kz in 1/D of the modes of a periodic box, broadcast over (z, y, x)."""
    kx, ky, kz = (2.0 * np.pi * np.fft.fftfreq(n, length / n) for n, length in zip(shape[::-1], box, strict=True))
    return kx[None, None, :], ky[None, :, None], kz[:, None, None]


def gradients(velocity, box):
    """du_i/dx_j (3, 3, z, y, x) in U/D by Fourier transform: the solver's own derivative."""
    k = wavenumbers(velocity[0].shape, box)
    modes = [np.fft.fftn(v) for v in velocity]
    return np.array([[np.fft.ifftn(1j * kj * m).real for kj in k] for m in modes])


def spectrum(velocity, box):
    """Kinetic energy in shells of |k|, (k, E) in 1/D and U^2 D; the box's mean is no part of it."""
    kx, ky, kz = wavenumbers(velocity[0].shape, box)
    shell = (np.sqrt(kx**2 + ky**2 + kz**2) / BAND).astype(int)
    energy = sum(np.abs(np.fft.fftn(v) / v.size) ** 2 for v in velocity) / 2.0
    energy[0, 0, 0] = 0.0
    sums = np.bincount(shell.ravel(), energy.ravel())
    return (np.arange(len(sums)) + 0.5) * BAND, sums / BAND


def resolution(state) -> dict:
    """Numbers of a solution, in D and U: of the jet where the vorticity is, not of the still fluid around it."""
    velocity, box, reynolds = [state[n] for n in ("vx", "vy", "vz")], state["box"], float(state["reynolds"])
    shape = velocity[0].shape
    spacing = float(max(length / n for n, length in zip(shape[::-1], box, strict=True)))
    cutoff = 2.0 / 3.0 * np.pi / spacing
    g = gradients(velocity, box)
    divergence = float(np.abs(np.trace(g)).max())
    strain = 0.5 * (g + g.swapaxes(0, 1))
    dissipation = 2.0 / reynolds * (strain**2).sum((0, 1))
    ordered = np.sort(dissipation.ravel())[::-1]
    half = ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())]  # half of it happens above this rate
    scales = {
        "mean_in_jet": float(dissipation.sum() * spacing**3 / (box[0] * np.pi * 0.8**2)),
        "half_of_it_above": float(half),
        "largest": float(ordered[0]),
    }
    k, energy = spectrum(velocity, box)
    centre = (shape[0] // 2, shape[1] // 2)
    return {
        "t_D_U": float(state["t"]),
        "reynolds": reynolds,
        "layer_D": float(state["layer"]),
        "grid_x_y_z": list(shape[::-1]),
        "box_D_x_y_z": [float(v) for v in box],
        "spacing_D": spacing,
        "largest_wavenumber_D": cutoff,
        "processor_s": float(state["processor_s"]),
        "divergence_of_the_solver_over_largest_gradient": divergence / float(np.abs(g).max()),
        "largest_gradient_U_D": float(np.abs(g).max()),
        "mean_u_on_the_axis_U": float(velocity[0][centre].mean()),
        "rms_v_on_the_axis_U": float(velocity[1][centre].std()),
        "dissipation_U3_D": scales,
        "largest_wavenumber_times_kolmogorov_length": {
            name: float(cutoff * (1.0 / reynolds**3 / rate) ** 0.25) for name, rate in scales.items()
        },
        "spacing_over_kolmogorov_length": {
            name: float(spacing / (1.0 / reynolds**3 / rate) ** 0.25) for name, rate in scales.items()
        },
        "spectrum_k_D": [float(v) for v in k[k < 1.2 * cutoff]],
        "spectrum_energy_U2_D": [float(f"{v:.3e}") for v in energy[k < 1.2 * cutoff]],
    }


def dataset(state) -> xarray.Dataset:
    """The solution in m/s on mm; the jet's axis at y = z = 0, x from -18 mm on."""
    u_m_s = float(state["reynolds"]) * NU_MM2_S / D_MM * 1e-3
    shape, attributes = state["vx"].shape, {"units": "mm"}
    axes = {
        name: (name, (np.arange(n) - n // 2) * (float(length) * D_MM / n), {**attributes, "axis": name.upper()})
        for name, n, length in zip("xyz", shape[::-1], state["box"], strict=True)
    }
    variables = {
        name: (("z", "y", "x"), state[f"v{axis}"] * u_m_s, {"units": "m s-1", "long_name": f"velocity along {axis}"})
        for name, axis in zip("uvw", "xyz", strict=True)
    }
    about = {
        "Conventions": "CF-1.11",
        "title": "Temporal round jet along x, D = 6 mm, Re = U D / nu = 2500 in water, U = 0.417 m/s; periodic",
        "source": "direct numerical simulation, fluidsim ns3d; paper/jet/solve.py of PlenoPIV",
        "comment": f"t = {float(state['t']):.2f} D/U; velocities are whole numbers of {STEP_M_S} m/s",
    }
    return xarray.Dataset(variables, axes, about)


def write(data: xarray.Dataset, path: Path) -> None:
    """As 16-bit whole numbers of STEP_M_S, shuffled and deflated."""
    packed = {"dtype": "int16", "scale_factor": STEP_M_S, "_FillValue": np.int16(-32768)}
    packed |= {"zlib": True, "complevel": 9, "shuffle": True, "chunksizes": (8, *data["u"].shape[1:])}
    data.to_netcdf(path, engine="h5netcdf", encoding=dict.fromkeys("uvw", packed))


def sampled(velocity: GriddedVelocity, rng) -> dict[str, float]:
    """Divergence through the sampler at points in the jet: largest and RMS, over the same of the gradient."""
    r, a = 3.0 * (0.6 + rng.random(POINTS)), 2.0 * np.pi * rng.random(POINTS)
    points = np.stack([36.0 * rng.random(POINTS), r * np.cos(a), r * np.sin(a)], -1)
    h = 1e-3 * np.eye(3)
    g = np.stack([(velocity(points + s) - velocity(points - s)) / 2e-3 for s in h], -1)
    divergence = np.trace(g, axis1=1, axis2=2)
    return {
        "largest": float(np.abs(divergence).max() / np.abs(g).max()),
        "rms": float(np.sqrt((divergence**2).mean() / (g**2).mean())),
    }


def main() -> None:
    """Read a solution, write the snapshot and the report."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("state", type=Path)
    arguments.add_argument("--out", type=Path, default=ROOT / "src" / "plenopiv" / "simulation" / "jet.nc")
    arguments.add_argument("--report", type=Path, default=ROOT / "paper" / "jet" / "resolution.json")
    wanted = arguments.parse_args()
    with np.load(wanted.state) as state:
        report, data = resolution(state), dataset(state)
    write(data, wanted.out)
    stored = read_netcdf(wanted.out)
    exact = np.stack([data[name].values for name in "uvw"], -1)
    whole = FileGrid(wanted.out, exact, stored.first, stored.spacing, ("mm",) * 3, ("m/s",) * 3)
    report |= {
        "megabytes": wanted.out.stat().st_size / 1e6,
        "stored_step_m_s": STEP_M_S,
        "largest_rounding_m_s": float(np.abs(stored.velocity - exact).max()),
        "divergence_through_the_sampler": {
            name: sampled(grid.in_mm_and_m_s(outside="periodic"), np.random.default_rng(0))
            for name, grid in {"as_solved": whole, "as_stored": stored}.items()
        },
    }
    wanted.report.write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps({k: v for k, v in report.items() if not k.startswith("spectrum")}, indent=2))


if __name__ == "__main__":
    main()
