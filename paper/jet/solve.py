"""Solve the jet: fluidsim's pseudo-spectral Navier-Stokes solver, in an environment of its own.

A *temporal* round jet: a column of fluid that moves along x in a periodic box and rolls up everywhere at once, in time.
It is not the jet that leaves a nozzle and develops along x; that needs an inlet and a longer box than one processor
solves. Lengths are in D, velocities in U, times in D/U; Re = U D/nu.

    python3.11 -m venv build/jet
    build/jet/bin/pip install fluidsim==26.10.0 fluidfft==0.4.5 pyfftw==0.15.1
    build/jet/bin/python paper/jet/solve.py 192 128 128 8

writes build/jet/192x128x128/state-<time>.npz at every time of SAVED: vx, vy, vz as (z, y, x). A run goes on from the
newest of them. A fourth number is the time to stop at. nice -n 19 keeps the machine usable meanwhile.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

BUILD = Path(__file__).parents[2] / "build" / "jet"
BOX = (6.0, 4.0, 4.0)  # along x, y, z: 36 x 24 x 24 mm for D = 6 mm; the jet's images are four diameters away
REYNOLDS = 2500.0
LAYER = 0.05  # delta of u = (1 - tanh((r - 1/2) / delta)) / 2, so momentum thickness 1/40, vorticity thickness 1/10
NOISE = 0.03  # RMS of one component in the middle of the shear layer, in U
SHORTEST = 0.25  # wavelength in D below which the noise is cut off
FRAME = 0.5  # the box moves along x with this share of U: the largest speeds, and the time step, halve
SAVED = (2.0, 4.0, 6.0, 8.0, 10.0, 12.0)


def column(x, y, z):
    """Axial velocity (z, y, x) of the undisturbed jet, between 0 and 1."""
    r = np.sqrt(y**2 + z**2)
    return 0.5 * (1.0 - np.tanh((r - 0.5) / LAYER)) + 0.0 * x


def noise(shape, wavenumbers, y, z, rng):
    """Random velocities of the shear layer alone, three of (z, y, x); the solver's projection makes them solenoidal."""
    kx, ky, kz = wavenumbers
    kept = kx**2 + ky**2 + kz**2 < (2.0 * np.pi / SHORTEST) ** 2
    envelope = np.exp(-(((np.sqrt(y**2 + z**2) - 0.5) / (2.0 * LAYER)) ** 2))
    for _ in range(3):
        white = np.fft.fftn(rng.standard_normal(shape))
        smooth = np.fft.ifftn(white * kept).real
        yield NOISE * envelope * smooth / smooth.std()


def simulation(nx: int, ny: int, nz: int):
    """The solver with its parameters; its fields still to be set."""
    from fluidsim.solvers.ns3d.solver import Simul

    params = Simul.create_default_params()
    params.oper.nx, params.oper.ny, params.oper.nz = nx, ny, nz
    params.oper.Lx, params.oper.Ly, params.oper.Lz = BOX
    params.oper.type_fft = "fft3d.with_pyfftw"
    params.oper.coef_dealiasing = 2.0 / 3.0
    params.nu_2 = 1.0 / REYNOLDS
    params.time_stepping.type_time_scheme = "RK4"
    params.time_stepping.deltat_max = 0.05
    params.time_stepping.deltat0 = 0.01
    params.init_fields.type = "in_script"
    params.output.HAS_TO_SAVE = False
    params.output.periods_print.print_stdout = 0
    return Simul(params)


def initial(sim, seed: int = 1):
    """The disturbed column, in the frame that moves with the box."""
    oper = sim.oper
    shape = oper.shapeX_loc
    x, y, z = ((np.arange(n) - n // 2) * (length / n) for n, length in zip(shape[::-1], BOX, strict=True))
    z, y, x = np.meshgrid(z, y, x, indexing="ij", sparse=True)
    k = [2.0 * np.pi * np.fft.fftfreq(n, length / n) for n, length in zip(shape[::-1], BOX, strict=True)]
    kz, ky, kx = np.meshgrid(k[2], k[1], k[0], indexing="ij", sparse=True)
    vx, vy, vz = noise(shape, (kx, ky, kz), y, z, np.random.default_rng(seed))
    return column(x, y, z) - FRAME + vx, vy, vz


def start(sim, fields) -> None:
    """Give the solver these fields, dealiased and projected on div = 0."""
    vx, vy, vz = (np.ascontiguousarray(f) for f in fields)
    sim.state.init_statephys_from(vx=vx, vy=vy, vz=vz)
    sim.state.statespect_from_statephys()
    sim.oper.dealiasing(sim.state.state_spect)
    sim.project_state_spect(sim.state.state_spect)
    sim.state.statephys_from_statespect()
    sim.output.init_with_initialized_state()


def main() -> None:
    """Solve to the last time of SAVED."""
    os.environ.setdefault("FLUIDSIM_PATH", str(BUILD / "fluidsim"))  # both before the solver is imported
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    nx, ny, nz = (int(n) for n in sys.argv[1:4])
    last = float(sys.argv[4]) if len(sys.argv) > 4 else SAVED[-1]
    BUILD.mkdir(parents=True, exist_ok=True)
    folder = BUILD / f"{nx}x{ny}x{nz}"
    folder.mkdir(exist_ok=True)
    sim = simulation(nx, ny, nz)
    stepping = sim.time_stepping
    earlier = sorted(folder.glob("state-*.npz"))
    if earlier:
        with np.load(earlier[-1]) as state:
            start(sim, [state[name] - (FRAME if name == "vx" else 0.0) for name in ("vx", "vy", "vz")])
            stepping.t, processor = float(state["t"]), float(state["processor_s"])
    else:
        start(sim, initial(sim))
        processor = 0.0

    saved = [t for t in SAVED if stepping.t + 1e-9 < t <= last]
    before = time.process_time()
    while saved:
        stepping.one_time_step()
        if stepping.it % 10 == 0:
            vx = sim.state.state_phys.get_var("vx")
            print(
                f"step {stepping.it}, t = {stepping.t:.3f} D/U, dt = {stepping.deltat:.4f}, "
                f"{time.process_time() - before:.0f} CPU-s, largest u {vx.max() + FRAME:.3f}",
                flush=True,
            )
        if stepping.t >= saved[0] - 1e-9:
            fields = {name: sim.state.state_phys.get_var(name) for name in ("vx", "vy", "vz")}
            fields["vx"] = fields["vx"] + FRAME
            seconds = processor + time.process_time() - before
            name = folder / f"state-{saved.pop(0):05.1f}.npz"
            np.savez(name, **fields, t=stepping.t, processor_s=seconds, reynolds=REYNOLDS, box=BOX, layer=LAYER)


if __name__ == "__main__":
    main()
