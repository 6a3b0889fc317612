"""Controls of the page's 3D scene, slices and picture stacks, as HTML; the scripts in ``browser`` operate them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from plenopiv.report.document import data_block, plain
from plenopiv.report.stacks import Stack

WITHOUT = (
    '<noscript><p class="fine">Scripts are switched off: this picture needs them. The figures below show the middle of '
    "the volume.</p></noscript>"
)

READOUT = '<p class="readout" data-said="pointer" aria-live="off">Point at a place to read its values.</p>'


def field_block(field: Mapping[str, Any]) -> str:
    """The field that scene and slices draw."""
    return data_block("field", field)


def scene(field: Mapping[str, Any]) -> str:
    """The 3D scene: isosurface, slices, arrows, and what is shown of them."""
    criteria = {name: found["label"] for name, found in field["criteria"].items()} | {"": "none"}
    planes = "".join(
        f'<label class="wide-label"><span><input type="checkbox" data-control="show-{axis}"{checked}> slice across '
        f'{axis} <output data-said="slice-{axis}"></output></span>'
        f"{_slider(f'slice-{axis}', len(field['axes'][axis]), f'place of the slice across {axis}')}</label>"
        for axis, checked in (("z", " checked"), ("y", ""), ("x", ""))
    )
    front = "along z" if field["laboratory"] else "as the camera sees it"
    controls = (
        f"{_time(field)}<label>isosurface of {_choice('criterion', criteria, field['start'])}</label>"
        '<label class="wide-label"><span>level <output data-said="level"></output></span>'
        '<input type="range" data-control="level" min="1" max="99" value="40" aria-label="level of the isosurface">'
        f"</label>{planes}{_colour(field)}"
        '<label><input type="checkbox" data-control="arrows" checked> arrows</label>'
        f'<button type="button" data-control="front">{front}</button>'
    )
    canvases = (
        '<canvas class="solid" aria-hidden="true"></canvas><canvas class="flat" tabindex="0" role="img" '
        'aria-label="The velocity volume in 3D; arrow keys turn it, plus and minus enlarge it"></canvas>'
    )
    absent = (
        '<p class="absent fine" hidden>This browser has no WebGL, so the scene cannot be drawn. The slices below show '
        "the same vectors.</p>"
    )
    return _viewer("scene", canvases, controls + _save() + _part(field), absent + READOUT)


def slices(field: Mapping[str, Any]) -> str:
    """Vector slices: which axis they cross, where, and what is coloured."""
    normals = {"y": "y (depth upward)", "z": "z (as the camera sees)", "x": "x (depth to the right)"}
    if field["laboratory"]:
        normals = {"y": "y (z upward)", "z": "z (y upward)", "x": "x (z to the right)"}
    controls = (
        f"{_time(field)}<label>across {_choice('normal', normals)}</label>"
        '<label class="wide-label"><span>place <output data-said="place"></output></span>'
        f"{_slider('place', len(field['axes']['y']), 'place of the slice')}</label>"
        f"{_colour(field)}"
    )
    canvas = '<canvas role="img" aria-label="A slice of the velocity field"></canvas>'
    return _viewer("slices", canvas, controls + _save(), READOUT)


def stack(pictures: Stack, words: str) -> str:
    """Pictures under a slider; how bright they are and what part of them is shown."""
    controls = (
        '<label class="wide-label"><output data-said="place"></output>'
        f'<input type="range" data-control="place" min="0" max="{len(pictures.pictures) - 1}" '
        f'value="{pictures.start}" aria-label="{plain(words)}"></label>'
        f"{_tone('black', 0, 95, 0, 'counts that are black')}{_tone('white', 2, 100, 100, 'counts that are white')}"
        f"{_tone('gamma', 20, 300, 100, 'gamma')}"
        '<button type="button" data-control="nearer" aria-label="enlarge">+</button>'
        '<button type="button" data-control="farther" aria-label="make smaller">−</button>'
        '<button type="button" data-control="whole">whole picture</button>'
    )
    canvas = f'<canvas role="img" aria-label="{plain(words)}"></canvas>'
    viewer = _viewer(pictures.name, canvas, controls + _save(), READOUT, kind="viewer stack")
    return data_block(pictures.name, pictures.data()) + viewer


def _time(field: Mapping[str, Any]) -> str:
    """Which time of a series is shown, or mean or RMS; nothing where there is one time."""
    times = sum(moment["kind"] == "time" for moment in field["moments"])
    if len(field["moments"]) < 2:
        return ""
    kinds = {"time": "one time", "mean": "mean", "rms": "RMS fluctuation"}
    return (
        f"<label>show {_choice('moment', kinds)}</label>"
        '<label class="wide-label"><span><output data-said="time"></output></span>'
        f'<input type="range" data-control="time" min="0" max="{times - 1}" value="{field["first"]}" '
        'aria-label="time"></label>'
    )


def _colour(field: Mapping[str, Any]) -> str:
    """What is coloured, and between which values; from the data where none are given."""
    names = {name: found["label"] for name, found in field["quantities"].items()}
    ends = "".join(
        f'<label>{word} <input type="number" step="any" data-control="{name}" placeholder="data"></label>'
        for name, word in (("low", "from"), ("high", "to"))
    )
    return f'<label>colour {_choice("colour", names)}</label><span class="ends">{ends}</span>'


def _part(field: Mapping[str, Any]) -> str:
    """Between which planes the scene is drawn."""
    rows = ""
    for axis in "xyz":
        last = len(field["axes"][axis]) - 1
        rows += f'<div class="part"><output data-said="part-{axis}"></output>'
        for end, value in (("first", 0), ("last", last)):
            rows += (
                f'<input type="range" data-control="{end}-{axis}" min="0" max="{last}" value="{value}" '
                f'aria-label="{end} plane along {axis}">'
            )
        rows += "</div>"
    return f"<details><summary>sub-volume</summary>{rows}</details>"


def _tone(name: str, low: int, high: int, start: int, words: str) -> str:
    """A slider of a picture's brightness."""
    return (
        f'<label class="wide-label"><span>{words} <output data-said="{name}"></output></span>'
        f'<input type="range" data-control="{name}" min="{low}" max="{high}" value="{start}" aria-label="{words}">'
        "</label>"
    )


def _viewer(name: str, canvases: str, controls: str, more: str = "", kind: str = "viewer") -> str:
    return (
        f'<div class="{kind}" id="{plain(name)}"><div class="stage">{canvases}</div>{more}{WITHOUT}'
        f'<div class="controls">{controls}</div></div>'
    )


def _choice(name: str, options: Mapping[str, str], start: str | None = None) -> str:
    items = "".join(
        f'<option value="{plain(value)}"{" selected" if value == start else ""}>{plain(label)}</option>'
        for value, label in options.items()
    )
    return f'<select data-control="{name}">{items}</select>'


def _slider(name: str, count: int, words: str) -> str:
    return (
        f'<input type="range" data-control="{name}" min="0" max="{max(count - 1, 0)}" value="{count // 2}" '
        f'aria-label="{plain(words)}">'
    )


def _save() -> str:
    return '<button type="button" data-control="save">save as PNG</button>'
