"""Whole files of every kind that the program reads, small ones, which the fuzzer then spoils."""

from __future__ import annotations

import base64
import io
import json
import lzma
import zlib
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np

COLUMNS, ROWS = 280, 224
SHEET = {
    "main_lens": {"focal_length_mm": 50.0, "aperture_mm": 25.0, "magnification": -1.0},
    "microlens_array": {"lattice": "hexagonal", "pitch_mm": 0.077, "focal_length_mm": 0.308},
    "sensor": {"columns": COLUMNS, "rows": ROWS, "pixel_pitch_mm": 0.0055, "bits": 12, "black_level": 60},
    "recording": {"orientation": "upright", "dt_s": 0.0005},
    "seeding": {"depth_mm": [-1.0, 1.0]},
}
FLOW_TABLE = """
[simulation]
flow = "file"
parameters = { path = "FLOW", outside = "zero", length_unit = "mm", velocity_unit = "m/s", at_mm = [0.0, 0.0, 0.0] }
particles_per_microlens = 0.2
rays = 200
seed = 3
"""
PACK = {"vtkZLibDataCompressor": zlib.compress, "vtkLZMADataCompressor": lzma.compress}


def build(folder: Path) -> None:
    """Write all of them below ``folder``: optics sheets, a recording, images, flows, results."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "optics.json").write_text(json.dumps(SHEET, indent=1))
    lines = [
        f"[{table}]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in keys.items()) for table, keys in SHEET.items()
    ]
    (folder / "optics.toml").write_text("\n".join(lines))
    _recording(folder)
    _images(folder)
    _flows(folder)
    _results(folder)


def _recording(folder: Path) -> None:
    """A simulated recording that ``check`` and ``calibrate`` take a second for, and what ``init`` drafts for it."""
    from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
    from plenopiv.cli import main
    from plenopiv.lattice import Lattice
    from plenopiv.sensor import Sensor
    from plenopiv.simulation.flows import flow
    from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

    camera = PlenopticCamera(
        MainLens(50.0, 25.0, -1.0),
        Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
        0.308,
        Sensor(COLUMNS, ROWS, 0.0055, 12, 60),
    )
    simulate_recording(
        folder / "rec",
        camera,
        flow("uniform"),
        dt_s=0.0005,
        volume_mm=((-0.3, 0.3), (-0.2, 0.2), (-1.0, 1.0)),
        seeding=Seeding(particles_per_microlens=0.3),
        rays=2000,
        diffraction=False,
        windows=((32, 24, 16),),
        seed=5,
    )
    (folder / "draft").mkdir()
    for name in ("white.tif", "a.tif", "b.tif"):
        (folder / "draft" / name).write_bytes((folder / "rec" / name).read_bytes())
    with redirect_stdout(io.StringIO()):
        failed = main(["init", str(folder / "draft"), str(folder / "optics.json")])
    if failed:
        raise RuntimeError("the recording that the fuzzer starts from has no draft")


def _images(folder: Path) -> None:
    import h5py
    import imagecodecs
    import tifffile

    out = folder / "images"
    out.mkdir()
    counts = tifffile.imread(folder / "rec" / "a.tif")
    small = counts[:48, :64]
    for name, options in {
        "plain": {},
        "strips": {"rowsperstrip": 20},
        "big-endian": {"byteorder": ">"},
        "bigtiff": {"bigtiff": True},
        "tiled": {"tile": (16, 32)},
        "lzw": {"compression": "lzw"},
        "deflate": {"compression": "adobe_deflate", "predictor": True, "rowsperstrip": 30},
        "zstd": {"compression": "zstd"},
        "packbits": {"compression": "packbits"},
        "lzma": {"compression": "lzma"},
        "tagged": {
            "description": '{"a": 1}',
            "software": "camera",
            "datetime": "2024:01:02 03:04:05",
            "metadata": None,
        },
    }.items():
        tifffile.imwrite(out / f"{name}.tif", counts, photometric="minisblack", **options)
    tifffile.imwrite(out / "eight.tif", (counts >> 4).astype(np.uint8))
    tifffile.imwrite(out / "pages.tif", np.stack([small] * 5), photometric="minisblack")
    (out / "image.png").write_bytes(imagecodecs.png_encode(counts))
    np.save(out / "image.npy", counts)
    np.save(out / "stack.npy", np.stack([counts, counts + 1]))
    with h5py.File(out / "frames.h5", "w") as file:
        stack = np.stack([counts, counts[::-1]])
        file.create_dataset("run/frames", data=stack, chunks=(1, 64, 64), compression="gzip", shuffle=True)


def linear(points: np.ndarray) -> np.ndarray:
    """u, v, w in m/s at points in mm."""
    return np.stack([0.1 * points[..., 2], 0.2 * points[..., 0] + 0.01, 0.1 * points[..., 1]], -1)


def _flows(folder: Path) -> None:
    import xarray

    out = folder / "flows"
    out.mkdir()
    axes = {name: np.linspace(-half, half, n) for name, half, n in (("x", 1.0, 9), ("y", 1.0, 8), ("z", 2.0, 7))}
    z, y, x = np.meshgrid(axes["z"], axes["y"], axes["x"], indexing="ij")
    values = linear(np.stack([x, y, z], -1))
    data = xarray.Dataset(
        {name: (("z", "y", "x"), values[..., k], {"units": "m/s"}) for k, name in enumerate("uvw")},
        {name: (name, a, {"units": "mm"}) for name, a in axes.items()},
    )
    data.to_netcdf(out / "flow.nc", engine="h5netcdf")
    packed = {"dtype": "int16", "scale_factor": 1e-4, "_FillValue": -32768, "zlib": True, "chunksizes": (4, 4, 4)}
    data.to_netcdf(out / "packed.nc", engine="h5netcdf", encoding=dict.fromkeys("uvw", packed))
    for form, compressor in (
        ("ascii", None),
        ("binary", "vtkZLibDataCompressor"),
        ("raw", "vtkZLibDataCompressor"),
        ("raw", None),
        ("base64", "vtkLZMADataCompressor"),
    ):
        kind = {None: "", "vtkZLibDataCompressor": "-zlib", "vtkLZMADataCompressor": "-lzma"}[compressor]
        (out / f"{form}{kind}.vti").write_bytes(_vti(values, axes, form, compressor))
    for binary in (True, False):
        (out / f"{'binary' if binary else 'ascii'}.vtk").write_bytes(_legacy(values, axes, binary))


def _stored(values: np.ndarray, compressor: str | None, encoded: bool) -> bytes:
    """Bytes behind a header, as VTK's XML files have them."""
    data = values.astype("<f4").tobytes()
    if compressor is None:
        head, body = np.array([len(data)], "<u4").tobytes(), data
        return base64.b64encode(head + body) if encoded else head + body
    size = -(-len(data) // 2)
    parts = [PACK[compressor](data[k : k + size]) for k in range(0, len(data), size)]
    head = np.array([len(parts), size, len(data) % size, *map(len, parts)], "<u4").tobytes()
    body = b"".join(parts)
    return base64.b64encode(head) + base64.b64encode(body) if encoded else head + body


def _vti(values: np.ndarray, axes: dict[str, np.ndarray], form: str, compressor: str | None) -> bytes:
    inline, tail = b"", b""
    if form == "ascii":
        inline = " ".join(f"{v:.6g}" for v in values.ravel()).encode()
    elif form == "binary":
        inline = _stored(values, compressor, True)
    else:
        data = _stored(values, compressor, form == "base64")
        tail = f'<AppendedData encoding="{form}">_'.encode() + data + b"</AppendedData>"
    extent = " ".join(f"0 {len(a) - 1}" for a in axes.values())
    origin = " ".join(f"{a[0]:g}" for a in axes.values())
    spacing = " ".join(f"{a[1] - a[0]:.9g}" for a in axes.values())
    packed = f' compressor="{compressor}"' if compressor else ""
    stored = 'format="appended" offset="0"' if tail else f'format="{form}"'
    return (
        f'<?xml version="1.0"?>\n<VTKFile type="ImageData" byte_order="LittleEndian" header_type="UInt32"{packed}>\n'
        f'<ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}">\n<Piece Extent="{extent}">'
        f'<PointData>\n<DataArray type="Float32" Name="velocity" NumberOfComponents="3" {stored}>'.encode()
        + inline
        + b"</DataArray>\n</PointData></Piece></ImageData>\n"
        + tail
        + b"</VTKFile>\n"
    )


def _legacy(values: np.ndarray, axes: dict[str, np.ndarray], binary: bool) -> bytes:
    sizes = " ".join(str(len(a)) for a in axes.values())
    origin = " ".join(f"{a[0]:g}" for a in axes.values())
    spacing = " ".join(f"{a[1] - a[0]:.9g}" for a in axes.values())
    points = values[..., 0].size

    def numbers(array: np.ndarray) -> bytes:
        return array.astype(">f4").tobytes() if binary else " ".join(f"{v:.6g}" for v in array.ravel()).encode()

    head = "# vtk DataFile Version 3.0\na flow\n" + ("BINARY" if binary else "ASCII") + "\nDATASET STRUCTURED_POINTS\n"
    head += f"DIMENSIONS {sizes}\nORIGIN {origin}\nSPACING {spacing}\nPOINT_DATA {points}\n"
    return (
        head.encode() + b"FIELD FieldData 1\nnumber 1 %d float\n" % points + numbers(values[..., 0])
        + b"\nMETADATA\nINFORMATION 0\n\nVECTORS velocity float\n" + numbers(values) + b"\n"
    )  # fmt: skip


def _results(folder: Path) -> None:
    import xarray

    from plenopiv.displacement.field import DisplacementField
    from plenopiv.io import write_velocity
    from plenopiv.velocity import velocity_dataset
    from plenopiv.volume import VoxelGrid

    out = folder / "results"
    out.mkdir()
    rng = np.random.default_rng(2)
    shape = (4, 5, 6)
    centres = [16 + 8 * np.arange(n) for n in shape]
    field = DisplacementField(
        z=centres[0],
        y=centres[1],
        x=centres[2],
        displacement=rng.normal(size=(3, *shape)),
        raw=rng.normal(size=(3, *shape)),
        std=np.abs(rng.normal(size=(3, *shape))),
        valid=rng.random(shape) > 0.1,
        peak_ratio=1 + rng.random(shape),
    )
    grid = VoxelGrid((-0.5, -0.4, -1.0), (0.017, 0.017, 0.077), (48, 56, 64))
    one = velocity_dataset(field, grid, 0.0005, 0.00025)
    write_velocity(out / "one.nc", one)
    write_velocity(out / "two.nc", xarray.concat([one, one.assign_coords(time=[0.00075])], "time"))
