"""A small recording for the command line's tests, and what they do to it."""

from pathlib import Path

COLUMNS, ROWS = 280, 224
SHEET = {
    "main_lens": {"focal_length_mm": 50.0, "aperture_mm": 25.0, "magnification": -1.0},
    "microlens_array": {"lattice": "hexagonal", "pitch_mm": 0.077, "focal_length_mm": 0.308},
    "sensor": {"columns": COLUMNS, "rows": ROWS, "pixel_pitch_mm": 0.0055, "bits": 12, "black_level": 60},
    "recording": {"orientation": "upright", "dt_s": 0.0005},
    "seeding": {"depth_mm": [-1.5, 1.5]},
}


def tree(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in Path(folder).rglob("*")}


def edit(folder, old, new):
    file = folder / "experiment.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    return file
