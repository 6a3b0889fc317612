"""The HTML around a report's content: one file, a strict content-security policy, everything escaped.

Nothing that a user or an image file wrote gets into the page but as escaped text or as JSON in a data block. The policy
allows the page's own script and style by their hashes and pictures by data addresses, and nothing else: no network, no
other script, no eval, no inline style.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHARPER = 1.75  # pixels of a panel in a pixel of the page
SCRIPTS = (
    "axes.js",
    "field.js",
    "controls.js",
    "isosurface.js",
    "solids.js",
    "box.js",
    "gl.js",
    "scene.js",
    "slices.js",
    "stacks.js",
    "start.js",
)

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
{body}
<footer>Lengths in mm, velocities in m/s, {frame}. Written by PlenoPIV.</footer>
<script>{script}</script>
</body>
</html>
"""


def page(title: str, body: str, laboratory: bool = False) -> str:
    """A whole page; ``title`` is plain text, ``body`` is HTML; ``laboratory``: whose x, y, z it shows, else the
    camera's."""
    style, script = style_sheet(), scripts()
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src '{_hash(script)}'",
            f"style-src '{_hash(style)}'",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    frame = "x, y, z of the laboratory" if laboratory else "z = 0 the focal plane, +z toward the camera"
    return PAGE.format(policy=policy, title=plain(title), style=style, script=script, body=body, frame=frame)


@cache
def scripts() -> str:
    """The scripts of the page, one after the other in a scope of their own."""
    parts = "\n".join(_asset(name) for name in SCRIPTS)
    return f'(() => {{\n"use strict";\n{parts}}})();\n'


@cache
def style_sheet() -> str:
    """The page's style: light, dark and print."""
    return _asset("style.css")


def plain(text: object) -> str:
    """Text for HTML, in contents and in attributes; what no UTF-8 file can hold (a file's name may) becomes "?"."""
    return escape(str(text).encode("utf-8", "replace").decode("utf-8"))


def data_block(name: str, content: Any) -> str:
    """JSON for the page's script to read. No text in it can end the block or begin a comment or an element."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))  # ASCII: U+2028 and surrogates are escaped
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return f'<script type="application/json" id="{plain(name)}-data">{text}</script>'


def section(heading: str, words: str, *content: str, name: str = "") -> str:
    """A section with a heading and a sentence or two, plain text both, and HTML."""
    place = f' id="{plain(name)}"' if name else ""
    text = f"<p>{plain(words)}</p>" if words else ""
    return f"<section{place}><h2>{plain(heading)}</h2>{text}{''.join(content)}</section>"


def subheading(heading: str, words: str = "") -> str:
    """A heading within a section, and a sentence or two."""
    return f"<h3>{plain(heading)}</h3>" + (f"<p>{plain(words)}</p>" if words else "")


def picture(png: bytes, words: str, kind: str = "") -> str:
    """A figure as PNG; ``kind`` "chart" for line charts, which a dark page inverts."""
    return pictures([png], words, kind)


def pictures(panels: Sequence[bytes], words: str, kind: str = "") -> str:
    """The panels of a figure as PNG, side by side where the page is wide and one below the other where it is narrow."""
    kind = f"{kind} panels".strip() if len(panels) > 1 else kind
    shown = ""
    for k, png in enumerate(panels):
        said = words if len(panels) == 1 else f"{words}, panel {k + 1} of {len(panels)}"
        size = f' width="{int.from_bytes(png[16:20]) / SHARPER:.0f}"' if len(panels) > 1 else ""  # PNG, 11.2.1
        image = base64.b64encode(png).decode("ascii")
        shown += f'<img alt="{plain(said)}"{size} src="data:image/png;base64,{image}">'
    return f'<figure class="{plain(kind)}">{shown}</figure>'


def table(values: Mapping[str, Any], first: str) -> str:
    """A table of keys and values."""
    rows = "".join(f"<tr><th>{plain(k)}</th><td>{plain(as_text(v))}</td></tr>" for k, v in values.items())
    head = f"<thead><tr><th>{plain(first)}</th><td>value</td></tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{rows}</tbody></table></div>'


def bars(rows: Sequence[tuple[str, float, str]]) -> str:
    """A table of names, texts, and bars as long as the numbers."""
    longest = max((value for _, value, _ in rows), default=0.0) or 1.0
    body = "".join(
        f"<tr><th>{plain(name)}</th><td>{plain(text)}</td>"
        f'<td><svg class="bar" viewBox="0 0 100 4" preserveAspectRatio="none" role="presentation">'
        f'<rect width="{max(100 * value / longest, 0):.1f}" height="4"></rect></svg></td></tr>'
        for name, value, text in rows
    )
    return f'<div class="wide"><table><tbody>{body}</tbody></table></div>'


def place_mm(value: float, places_mm: NDArray[np.floating]) -> str:
    """A position in mm, to a tenth of the distance between evenly spaced ``places_mm`` if that is below .1 mm."""
    apart = abs(float(places_mm[1]) - float(places_mm[0])) if len(places_mm) > 1 else 0.0
    digits = max(2, 1 - int(np.floor(np.log10(apart)))) if apart > 0 else 2
    return f"{value:.{digits}f}"


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one, with dotted keys."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found


def as_text(value: Any) -> str:
    """A value as a reader wants it: six digits, thousands set apart."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, list | tuple | np.ndarray):
        return ", ".join(as_text(item) for item in value)
    return "–" if value is None else str(value)


def _asset(name: str) -> str:
    return files("plenopiv.report").joinpath("browser", name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}"
