"""Reports in Chromium: they draw, turn, their sliders move what they should, and they ask for nothing."""

import math

import pytest
from reports import ALSO, MAKERS, ROOT

import plenopiv

SCREENSHOTS = ROOT / "build" / "screenshots"
any_report = pytest.mark.parametrize("report", [next(iter(MAKERS))], indirect=True)  # of what no report changes

OVERLAPS = """() => {
  const boxes = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement;
    const hidden = "script, style, noscript, details:not([open]) > :not(summary), option";
    if (!node.textContent.trim() || parent.closest(hidden)) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const r of range.getClientRects())
      if (r.width > 1 && r.height > 1) boxes.push([r.left, r.top + 2, r.right, r.bottom - 2, node.textContent.trim()]);
  }
  for (const e of document.querySelectorAll("select, input, button, img, .stage")) {
    const r = e.getBoundingClientRect();
    const seen = r.width > 1 && e.closest("figure, details:not([open]) > :not(summary)") === null;
    if (seen) boxes.push([r.left, r.top, r.right, r.bottom, e.outerHTML.slice(0, 60), e]);
  }
  const found = [];
  for (let i = 0; i < boxes.length; i++) for (let j = 0; j < i; j++) {
    const [a, b] = [boxes[i], boxes[j]];
    if (a[4] === b[4] || (a[5] && a[5].tagName === "BUTTON") || (b[5] && b[5].tagName === "BUTTON")) continue;
    const wide = Math.min(a[2], b[2]) - Math.max(a[0], b[0]), high = Math.min(a[3], b[3]) - Math.max(a[1], b[1]);
    if (wide > 1 && high > 1) found.push([a[4], b[4]]);
  }
  return found;
}"""
# Tables wider than the page, whose values would have to be scrolled to.
TABLES_BEYOND = """() => [...document.querySelectorAll(".wide")].filter((e) => e.scrollWidth > e.clientWidth + 1)
  .map((e) => e.textContent.trim().slice(0, 60))"""
# On canvases: texts over one another, and texts that a canvas cuts off.
ON_CANVASES = """() => {
  const found = [];
  for (const canvas of document.querySelectorAll("canvas")) {
    const written = canvas.written || [];
    written.forEach((a, i) => {
      if (a[0] < -1 || a[1] < -1 || a[2] > canvas.width + 1 || a[3] > canvas.height + 1) found.push([a[4], "cut off"]);
      for (const b of written.slice(0, i)) {
        const wide = Math.min(a[2], b[2]) - Math.max(a[0], b[0]), high = Math.min(a[3], b[3]) - Math.max(a[1], b[1]);
        if (wide > 0 && high > 0) found.push([a[4], b[4]]);
      }
    });
  }
  return found;
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("report", [*MAKERS, *ALSO], indirect=True)
def test_no_complaint_no_request_no_overlap(visit, width, scheme, request):
    made = visit(width, scheme)
    made.page.evaluate("document.querySelectorAll('.viewer details').forEach((part) => (part.open = true))")
    made.photograph(SCREENSHOTS, f"{request.node.callspec.params['report']}-{width}-{scheme}")
    assert made.complaints == []
    assert made.requests == [made.address]
    assert made.page.evaluate(OVERLAPS) == []
    assert made.page.evaluate("[...document.querySelectorAll('canvas')].some(canvas => canvas.written)")
    assert made.page.evaluate(ON_CANVASES) == []
    assert made.page.evaluate("document.documentElement.scrollWidth") <= width
    assert made.page.evaluate(TABLES_BEYOND) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_scene_draws_on_the_page_s_own_paper(visit, scheme):
    made = visit(scheme=scheme)
    assert int(made.page.get_attribute("#scene", "data-triangles")) > 500
    assert made.colours("#scene .solid")[0] > 200
    corner = made.page.evaluate(
        """() => { const gl = document.querySelector("#scene .solid").getContext("webgl"), p = new Uint8Array(4);
                   gl.readPixels(2, 2, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p); return [...p]; }"""
    )
    assert corner == {"light": [255, 255, 255, 255], "dark": [0x17, 0x1C, 0x21, 255]}[scheme]


def test_the_scene_turns_under_the_mouse_and_under_keys(visit):
    made = visit()
    before = made.colours("#scene .solid")
    made.page.locator("#scene .flat").scroll_into_view_if_needed()
    box = made.page.locator("#scene .flat").bounding_box()
    made.page.mouse.move(box["x"] + 200, box["y"] + 200)
    made.page.mouse.down()
    made.page.mouse.move(box["x"] + 300, box["y"] + 220, steps=3)
    made.page.mouse.up()
    turned = made.colours("#scene .solid")
    assert turned != before
    made.page.mouse.move(box["x"] + 400, box["y"] + 250)
    assert made.colours("#scene .solid") == turned  # released
    made.page.focus("#scene .flat")
    made.page.keyboard.press("ArrowLeft")
    assert made.colours("#scene .solid") != turned


def test_what_is_shown_of_the_scene_can_be_chosen(visit):
    made = visit()

    def triangles():
        return int(made.page.get_attribute("#scene", "data-triangles"))

    made.slide("#scene [data-control=criterion]", "q")
    everything = triangles()
    made.slide("#scene [data-control=arrows]", False)
    without_arrows = triangles()
    assert 0 < without_arrows < everything
    made.slide("#scene [data-control=criterion]", "")
    slice_alone = triangles()
    assert 0 < slice_alone < without_arrows
    made.slide("#scene [data-control=show-x]", True)
    assert triangles() > slice_alone
    for axis in "xyz":
        made.slide(f"#scene [data-control=show-{axis}]", False)
    assert triangles() == 0
    assert made.colours("#scene .solid")[0] == 1


@pytest.mark.parametrize("name", ["level", "slice-z"])
def test_sliders_of_the_scene_change_it_and_say_so(visit, name):
    made = visit()
    made.slide("#scene [data-control=criterion]", "vorticity")
    seen = set()
    for value in made.places(f"#scene [data-control={name}]"):
        made.slide(f"#scene [data-control={name}]", value)
        seen.add((made.page.inner_text(f"#scene [data-said={name}]"), made.colours("#scene .solid")[1]))
    assert len({text for text, _ in seen}) == len({picture for _, picture in seen}) == 3


def test_a_slice_moves_with_its_slider_and_turns_with_its_axis(visit):
    made = visit()
    seen = set()
    for normal in "xyz":
        made.slide("#slices [data-control=normal]", normal)
        for value in (0, 1):
            made.slide("#slices [data-control=place]", value)
            text = made.page.inner_text("#slices [data-said=place]")
            assert text.startswith(f"{normal} = ")
            seen.add((text, made.colours("#slices canvas")[1]))
    assert len({text for text, _ in seen}) == len({picture for _, picture in seen}) == 6


@pytest.mark.parametrize("name", ["volume", "views", "refocus"])
def test_a_stack_shows_another_picture_at_each_place(visit, name):
    made = visit()
    seen = set()
    for value in made.places(f"#{name} input"):
        made.slide(f"#{name} input", value)
        seen.add((made.page.inner_text(f"#{name} [data-said=place]"), made.colours(f"#{name} canvas")[1]))
    assert len({text for text, _ in seen}) == len({picture for _, picture in seen}) == 3


@any_report
@pytest.mark.parametrize("level", [0.5, 0.7])
def test_the_isosurface_of_a_sphere_has_its_area_volume_and_normals(visit, level):
    """Values 1 - r on a grid with unequal spacing: the surface is a sphere of radius 1 - level."""
    area, volume, inward, seams = visit().page.evaluate(
        """level => {
          const axis = (n) => Array.from({length: n}, (_, k) => -1 + 2 * k / (n - 1));
          const axes = {x: axis(41), y: axis(37), z: axis(33)}, values = [];
          for (const z of axes.z) for (const y of axes.y) for (const x of axes.x) values.push(1 - Math.hypot(x, y, z));
          const { at, normal } = plenopiv.isosurface(values, axes, level);
          let area = 0, volume = 0, inward = 0;
          const sides = new Map();
          for (let t = 0; t < at.length; t += 9) {
            const [a, b, c] = [0, 3, 6].map((k) => at.slice(t + k, t + k + 3));
            const p = b.map((v, i) => v - a[i]), q = c.map((v, i) => v - a[i]);
            const n = [p[1]*q[2] - p[2]*q[1], p[2]*q[0] - p[0]*q[2], p[0]*q[1] - p[1]*q[0]];
            area += Math.hypot(...n) / 2;
            volume += Math.abs(n[0]*a[0] + n[1]*a[1] + n[2]*a[2]) / 6;
            inward += a.reduce((sum, v, i) => sum + v * normal[t + i], 0) < 0.9 * Math.hypot(...a);
            const names = [a, b, c].map((v) => v.map((s) => Math.round(s * 1e7)).join());
            if (new Set(names).size < 3) continue;
            for (const [i, j] of [[0, 1], [1, 2], [0, 2]]) {
              const side = [names[i], names[j]].sort().join("|");
              sides.set(side, (sides.get(side) || 0) + 1);
            }
          }
          return [area, volume, inward, [...sides.values()].filter((n) => n % 2).length];
        }""",
        level,
    )
    radius = 1 - level
    assert area == pytest.approx(4 * math.pi * radius**2, rel=0.02)
    assert volume == pytest.approx(4 / 3 * math.pi * radius**3, rel=0.02)
    assert inward == 0
    assert seams == 0  # closed: every side belongs to two triangles


@any_report
def test_as_the_camera_sees_it_x_is_right_y_is_up_and_z_is_near(visit):
    right, up, near = visit().page.evaluate("plenopiv.turned({yaw: 0, pitch: 0})")
    assert (right, up, near) == ([1, 0, 0], [0, 1, 0], [0, 0, 1])


@any_report
def test_paper_is_white_though_the_screen_is_dark(visit):
    made = visit(scheme="dark")
    made.page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    shown = "document.querySelector('#slices canvas').getContext('2d').fillStyle"
    assert made.page.evaluate(shown) in ("#1f2933", "#ffffff")
    made.page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert made.page.evaluate(shown) == "#e4e8ec"


def test_no_hostile_text_runs(go, tmp_path, monkeypatch):
    """A page with hostile text everywhere: no dialog, no complaint, no request."""
    hostile = pytest.importorskip("test_hostile_text", reason="tests/report is not on the path")
    pytest.importorskip("pages").without_figures(monkeypatch)  # pictures hold no text to run
    for n, text in enumerate(hostile.HOSTILE):
        path = tmp_path / f"{n}.html"
        hostile.hostile_page(path, text)
        made = go(path)
        assert (made.dialogs, made.complaints, made.requests) == ([], [], [made.address])
        made.page.context.close()


@pytest.mark.filterwarnings("ignore:Glyph")
def test_a_run_of_hostile_files_runs_nothing_else(go, tmp_path):
    """Names, TIFF tags and comments of files, through a whole run."""
    files = pytest.importorskip("hostile_recording", reason="tests/report is not on the path")
    result = plenopiv.process(plenopiv.load(files.make(tmp_path / "recording")))
    made = go(result.directory / "report.html")
    assert (made.dialogs, made.complaints, made.requests) == ([], [], [made.address])
