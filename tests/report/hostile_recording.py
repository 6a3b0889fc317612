"""A recording whose files carry hostile text wherever files can: names, TIFF tags, comments of the experiment file."""

import tifffile
from test_hostile_text import HOSTILE

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

NAMES = ("a <svg onload=alert(1)>.tif", "b \"'><script>alert(1)<&#47;script>.tif", "c $\\frac{.tif")
FILE = "<img src=x onerror=alert(1)>.toml"
# ImageDescription, Make, Model, Software, DateTime, Artist, HostComputer, Copyright, DateTimeOriginal, UserComment's
# sibling XPComment, camera's serial number
TAGS = (270, 271, 272, 305, 306, 315, 316, 33432, 36867, 40092, 50735)


def stored(text):
    """A text as the bytes of a TIFF tag, which end at the first zero."""
    return text.encode("utf-8", "surrogateescape").replace(b"\0", b"")


def tag_with(path, text):
    """Write a text into every tag of an image."""
    image = tifffile.imread(path)
    tags = [(code, "s", 0, stored(text), True) for code in TAGS]
    tifffile.imwrite(path, image, software=False, metadata=None, extratags=tags)


def make(folder):
    """Simulate a small recording, spoil all its words, and return its experiment file."""
    camera = PlenopticCamera(
        MainLens(50.0, 25.0, -1.0),
        Lattice("hexagonal", 0.077, 0.004, (0.01, -0.02)),
        0.308,
        Sensor(300, 280, 0.0055, 12),
    )
    simulate_recording(
        folder,
        camera,
        flow("uniform", velocity_m_s=(0.1, -0.05, 0.1)),
        dt_s=0.0005,
        volume_mm=((-0.4, 0.4), (-0.4, 0.4), (-1.2, 1.2)),
        windows=((24, 24, 16), (24, 24, 16)),
        rays=1000,
        seed=5,
    )
    for old, new in zip(("a.tif", "b.tif", "a.tif"), NAMES, strict=True):
        (folder / new).write_bytes((folder / old).read_bytes())
    for name in ("a.tif", "b.tif"):
        (folder / name).unlink()
    for path in folder.glob("*.tif"):
        tag_with(path, "\n".join(HOSTILE))
    text = (folder / "experiment.toml").read_text()
    comments = "".join(f"# {line}\n" for text in HOSTILE for line in printable_lines(text))
    frames = 'frames = ["a.tif", "b.tif"]'
    assert frames in text
    (folder / FILE).write_text(comments + text.replace(frames, 'frames = "[abc] *.tif"'), encoding="utf-8")
    (folder / "experiment.toml").unlink()
    return folder / FILE


def printable_lines(text):
    """Lines that a TOML comment may hold: UTF-8 without control characters."""
    kept = "".join(c for c in text.encode("utf-8", "replace").decode() if c == "\n" or (c >= " " and c != "\x7f"))
    return kept.split("\n")
