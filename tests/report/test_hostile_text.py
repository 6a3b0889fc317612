"""Nothing that a user or an image wrote becomes part of the page but as text."""

import base64
import hashlib
import re
import tomllib
from itertools import islice

import pytest
from pages import SUMMARY, TEXT, Parsed, everything, example, field, without_figures, write

from plenopiv.experiment import Experiment
from plenopiv.report.document import data_block, page, scripts

HOSTILE = [
    "<script>alert(1)</script>",
    "</script><script>alert(1)</script>",
    "</SCRIPT ><img src=x onerror=alert(1)>",
    "<!--<script>",
    "--><script>alert(1)</script>",
    "]]><script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "<svg onload=alert(1)>",
    "<svg/onload=alert(1)>",
    "<body onload=alert(1)>",
    "<iframe src=javascript:alert(1)>",
    "<a href=javascript:alert(1)>x</a>",
    "<base href=//evil.invalid/>",
    "<meta http-equiv=refresh content='0;url=//evil.invalid'>",
    "<link rel=stylesheet href=//evil.invalid>",
    "<style>*{display:none}</style>",
    "</style><script>alert(1)</script>",
    "</title><script>alert(1)</script>",
    "</pre></details><script>alert(1)</script>",
    "</table><script>alert(1)</script>",
    "</noscript><script>alert(1)</script>",
    "<form action=//evil.invalid><button>x",
    "<input autofocus onfocus=alert(1)>",
    "<details open ontoggle=alert(1)>",
    "<video><source onerror=alert(1)>",
    "<object data=data:text/html,x>",
    "<embed src=javascript:alert(1)>",
    "<math><mtext><script>alert(1)</script>",
    "<template><script>alert(1)</script></template>",
    "<textarea><script>alert(1)</script>",
    '" onmouseover="alert(1)',
    "' onmouseover='alert(1)",
    '"><script>alert(1)</script>',
    "'><script>alert(1)</script>",
    "` onerror=alert(1) `",
    "&lt;script&gt;alert(1)&lt;/script&gt;",
    "&#60;script&#62;alert(1)&#60;/script&#62;",
    "\\u003cscript\\u003ealert(1)",
    "\u2028alert(1)\u2029",
    '";alert(1);//',
    "');alert(1);//",
    "${alert(1)}",
    "{{constructor.constructor('alert(1)')()}}",
    "{title}{body}{0}{policy.__class__}",
    "%s%d%(x)s",
    "$\\frac{",
    "_$x^{$_",
    "\x00\x01\x1b[31m\x7f",
    "\udcff\udc80.tif",
    "\u202egnp.exe\ufeff" + "x" * 400,
]


def test_there_are_fifty():
    assert len(set(HOSTILE)) == 50


def everywhere(text):
    """A summary with one text wherever a run puts names, words or keys."""
    frame = {"residual_counts_by_iteration": [2.0, 1.0], text: text}
    return SUMMARY | {
        "warnings": [text],
        "timings_s": {text: 1.0},
        "peak_memory_gb": {text: 1.0},
        "versions": {text: text},
        "experiment": text,
        "frames": [text],
        "calibration": {"lattice": text},
        "reconstruction": {text: frame},
    }


def skeleton(parsed):
    """Elements and attributes, without what differs between any two pages."""
    return [
        (tag, sorted(attributes.items() - {("src", attributes.get("src")), ("content", attributes.get("content"))}))
        for tag, attributes in parsed.elements
    ]


def hostile_page(path, text):
    content = tomllib.loads(TEXT)
    stored = text.encode("utf-8", "replace").decode()  # an experiment file is UTF-8
    named = stored.replace("\0", "")  # and no file name holds a NUL
    content["recording"] |= {"white": f"{named}.tif", "frames": [named, f"b{named}"]}
    content["output"] = {"directory": named}
    content["simulation"] = {"flow": stored, "parameters": {stored: stored}}
    return write(
        path,
        Experiment.from_dict(content),
        title=text,
        summary=everywhere(text),
        accuracy={text: text},
        **everything(example(), text),
    )


@pytest.fixture(scope="module")
def tame(tmp_path_factory):
    """A page with harmless text in the same places."""
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        return Parsed(hostile_page(tmp_path_factory.mktemp("tame") / "tame.html", "tame"))


@pytest.mark.parametrize("text", HOSTILE, ids=range(50))
def test_hostile_text_adds_no_element_and_no_attribute(tmp_path, text, tame, monkeypatch):
    without_figures(monkeypatch)  # drawn in the next test
    parsed = Parsed(hostile_page(tmp_path / "hostile.html", text))
    assert skeleton(parsed) == skeleton(tame)
    assert [raw for raw in parsed.raw if raw[1].get("id") is None] == [r for r in tame.raw if r[1].get("id") is None]
    kept = re.sub(r"\s+", " ", text.encode("utf-8", "replace").decode().replace("\x00", ""))
    assert kept[:60] in re.sub(r"\s+", " ", parsed.text.replace("\x00", "").replace("\ufffd", ""))


@pytest.mark.full
@pytest.mark.parametrize("text", [HOSTILE[0], *HOSTILE[45:]], ids=range(6))
@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_that_a_typesetter_would_trip_over_are_drawn(tmp_path, text, monkeypatch):
    """Dollars begin mathematics in matplotlib, underscores hide a label; control characters have no glyph. All figures
    with the first, with the others those that names and frames are written into."""
    if text != HOSTILE[0]:
        without_figures(monkeypatch, but=("raw_figure", "residual_figure"))
    assert len(Parsed(hostile_page(tmp_path / "report.html", text)).all("figure")) == 7


@pytest.mark.parametrize("text", HOSTILE, ids=range(50))
def test_a_data_block_cannot_be_left(text):
    parsed = Parsed(f"<p>{data_block('x', {text: [text, 1.5]})}</p>")
    assert [tag for tag, _ in parsed.elements] == ["p", "script"]
    assert parsed.all("script")[0]["type"] == "application/json"
    assert parsed.data("x") == {text: [text, 1.5]}
    inside = parsed.raw[0][2]
    assert not set(inside) & set("<>&\u2028\u2029")


def test_the_policy_allows_this_script_and_this_style_alone(tmp_path, monkeypatch):
    without_figures(monkeypatch)
    parsed = Parsed(write(tmp_path / "report.html", example(), field()))
    (meta,) = [m for m in parsed.all("meta") if m.get("http-equiv") == "Content-Security-Policy"]
    policy = dict(directive.split(" ", 1) for directive in meta["content"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["img-src"] == "data:"
    assert {policy["base-uri"], policy["form-action"]} == {"'none'"}
    assert "unsafe" not in meta["content"]
    executed = [raw for raw in parsed.raw if raw[1].get("type") != "application/json"]
    assert [raw[0] for raw in executed] == ["style", "script"]
    for kind, _, text in executed:
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert policy[f"{kind}-src"] == f"'sha256-{digest}'"
    assert not any(name.startswith("on") or name == "style" for _, a in parsed.elements for name in a)
    first = [tag for tag, _ in islice(parsed.elements, 4)]
    assert first == ["html", "head", "meta", "meta"]  # before anything that it must govern


def test_the_script_makes_no_code_and_no_html():
    assert not re.search(r"\beval\b|\bFunction\(|innerHTML|outerHTML|insertAdjacent|document\.write|fetch\(", scripts())


def test_a_title_is_text():
    assert Parsed(page("<b>&amp;", "<p>x</p>")).text.strip().startswith("<b>&amp;")
