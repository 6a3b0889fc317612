"""What several tests of the report share: a small field, an experiment, and the page as a parser reads it."""

import base64
import functools
import json
import tomllib
from html.parser import HTMLParser

import numpy as np
import xarray as xr

from plenopiv.experiment import Experiment
from plenopiv.lightfield import LightField, layout
from plenopiv.report import charts, figures, light_field_stacks, projections, raw_crops, volume_stack, write_report
from plenopiv.volume import DenseVolume

TEXT = """
[camera]
kind = "plenoptic"
main_lens = { focal_length_mm = 50.0, aperture_mm = 25.0, magnification = -1.0 }
microlens_array = { lattice = "hexagonal", pitch_mm = 0.077, focal_length_mm = 0.308 }
sensor = { columns = 280, rows = 224, pixel_pitch_mm = 0.0055, bit_depth = 12 }
[recording]
white = "white<1>.tif"
frames = ["a.tif", "b.tif"]
dt_s = 0.0005
orientation = "upright"
[volume]
x_mm = [-0.5, 0.5]
y_mm = [-0.4, 0.4]
z_mm = [-1.0, 1.0]
voxel_mm = [0.0171428571, 0.0171428571, 0.077]
[correlation]
windows = [[16, 16, 8]]
"""
SUMMARY = {
    "warnings": ["a.tif: 2 % <saturated>"],
    "timings_s": {"correlation": 2.5},
    "peak_memory_gb": {"correlation": 0.4},
    "versions": {"numpy": "2.0"},
    "lattice": {"pitch_mm": 0.077},
    "reconstruction": {"a.tif": {"residual_counts_by_iteration": [5.0, 3.0, 2.5]}},
}


def example():
    """An experiment."""
    return Experiment.from_dict(tomllib.loads(TEXT))


def field(shape=(4, 5, 6), nan=False):
    """A velocity field of noise, a tenth of it replaced."""
    rng = np.random.default_rng(0)
    dims, full = ("time", "z", "y", "x"), (1, *shape)
    values = {name: (dims, np.full(full, np.nan) if nan else rng.normal(size=full)) for name in ("u", "v", "w")}
    values |= {f"{name}_raw": values[name] for name in "uvw"}
    values |= {f"{name}_std": (dims, np.full(full, np.nan) if nan else rng.gamma(2, 0.1, full)) for name in "uvw"}
    values["valid"] = (dims, np.where(np.arange(np.prod(full)).reshape(full) % 10, 1, 0).astype(np.int8))
    values["peak_ratio"] = (dims, np.full(full, np.nan) if nan else 1 + rng.gamma(3, 1, full))
    axes = {axis: 0.2 * np.arange(n) - 0.1 * n for axis, n in zip("zyx", shape, strict=True)}
    return xr.Dataset(values, {"time": [0.0], **axes})


def everything(experiment, name="a.tif"):
    """Crops, projections and stacks of noise."""
    image, views, stacks = _pictures()
    return {"crops": raw_crops(image, experiment.camera(), name), "views": views, "stacks": list(stacks)}


@functools.cache
def _pictures():
    experiment, rng = example(), np.random.default_rng(0)
    image = rng.integers(0, 4000, (224, 280)).astype(np.uint16)
    volume = DenseVolume(experiment.grid(), rng.random(experiment.grid().shape, np.float32))
    where = layout(experiment.camera())
    light = LightField(where, np.where(where.seen, rng.random(where.seen.shape), 0).astype(np.float32) * 100)
    return image, projections(volume), (volume_stack(volume), *light_field_stacks(light, (-1.0, 1.0)))


def without_figures(patch, but=()):
    """Draw no figure in pages from now on: every one ``but`` those named is an empty picture. ``patch`` is pytest's
    monkeypatch."""
    for module in (charts, figures):
        for name in [name for name in vars(module) if name.endswith("_figure") and name not in but]:
            patch.setattr(module, name, lambda *given: None)
    drawn = figures.Drawn.of
    patch.setattr(figures.Drawn, "of", lambda figure, pdf=False: EMPTY if figure is None else drawn(figure, pdf))


EMPTY = figures.Drawn(np.zeros((1, 1, 4), np.uint8), ())


def write(path, experiment, dataset=None, summary=SUMMARY, title="Velocity of <jet>", **options):
    """Write a report, and give its text."""
    dataset = field() if dataset is None else dataset
    write_report(path, title=title, experiment=experiment, summary=summary, dataset=dataset, **options)
    return path.read_text(encoding="utf-8")


class Parsed(HTMLParser):
    """Elements of a page with their attributes, the text of scripts and styles, and the text outside of them."""

    VOID = ("meta", "img", "input", "br", "link", "rect")

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.elements, self.raw, self.text, self._open = [], [], "", []
        self.feed(page)
        self.close()
        assert self._open == [], "an element is not closed"

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self._open.append(tag)
        if tag in ("script", "style"):
            self.raw.append([tag, dict(attrs), ""])

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self._open.pop() == tag, f"{tag} is closed out of turn"

    def handle_data(self, data):
        if self._open and self._open[-1] in ("script", "style"):
            self.raw[-1][2] += data
        else:
            self.text += data

    def all(self, tag):
        """Attributes of all elements of a kind."""
        return [attributes for name, attributes in self.elements if name == tag]

    def data(self, name):
        """The JSON of a data block."""
        (text,) = [text for _, attributes, text in self.raw if attributes.get("id") == f"{name}-data"]
        return json.loads(text)


def numbers(packed):
    """What the page's script makes of packed numbers."""
    values = np.frombuffer(base64.b64decode(packed["data"]), {"u1": "u1", "u2": "<u2", "f4": "<f4"}[packed["kind"]])
    if packed["kind"] != "u2":
        return values
    return np.where(values == 65535, np.nan, packed["low"] + packed["step"] * values)
