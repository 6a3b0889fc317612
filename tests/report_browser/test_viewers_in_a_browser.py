"""The viewers of a series of five in Chromium: values under the pointer, colours, time, mean, RMS, parts; images."""

import re

import numpy as np
import pytest
from reports import ALSO

from plenopiv.io.netcdf import read_velocity
from plenopiv.statistics import SeriesStatistics

pytestmark = pytest.mark.skipif("series" not in ALSO, reason="another report is named")
NAMES = {"u": "u", "v": "v", "w": "w", "speed": "speed", "peak_ratio": "peak ratio"}
PLACES = [(0.31, 0.44), (0.42, 0.5), (0.36, 0.35), (0.4, 0.62), (0.28, 0.55), (0.45, 0.3)]  # of a canvas


@pytest.fixture
def five(go, reports, browser):
    """A function that visits the series."""
    return lambda width=1280, scheme="light": go(reports("series"), width, scheme)


@pytest.fixture
def truth(reports, browser):
    """What its velocity.nc holds."""
    return read_velocity(reports("series").parent / "velocity.nc")


def pointed(made, selector, share):
    """(vector's indices along x, y, z, {name: number as written}) under the pointer, or None where nothing is."""
    canvas = made.page.locator(f"{selector} .flat" if selector == "#scene" else f"{selector} canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    made.page.mouse.move(0, 0)
    made.page.mouse.move(box["x"] + share[0] * box["width"], box["y"] + share[1] * box["height"])
    made.page.wait_for_timeout(120)
    vector = made.page.get_attribute(selector, "data-vector")
    if vector is None:
        return None
    text = made.page.inner_text(f"{selector} [data-said=pointer]").replace("−", "-")
    found = dict(re.findall(r"(?:^|; |: |, )(?:RMS of )?([a-zA-Z -]+?) =? ?(-?[\d.]+)", text))
    found |= {f"{name}_std": std for name, std in re.findall(r"([uvw]) = -?[\d.]+ ± ([\d.e-]+)", text)}
    return tuple(int(part) for part in vector.split(",")), found, text


def same(said, wanted):
    """Whether a number as written is ``wanted``, rounded, or as near as the page's numbers are."""
    step = 10.0 ** -len(said.partition(".")[2])
    return abs(float(said) - wanted) <= 0.75 * step


def test_values_under_the_pointer_are_those_of_the_file(five, truth):
    made, seen = five(), set()
    for time in (0, 2, 3, 4):
        made.slide("#slices [data-control=time]", time)
        for selector in ("#slices", "#scene"):
            for share in PLACES:
                if (found := pointed(made, selector, share)) is None:
                    continue
                (i, j, k), said, text = found
                seen.add((time, selector, i, j, k))
                one = truth.isel(time=time, x=i, y=j, z=k)
                place = [float(part) for part in re.search(r"x = (.*), y = (.*), z = (.*) mm", text).groups()]
                assert place == pytest.approx([float(one[axis]) for axis in "xyz"], abs=6e-4)
                if not np.isfinite(one.u):
                    assert text.endswith("not measured")
                    continue
                assert ("replaced" in text) == (one.valid.item() != 1)
                values = {name: one[name].item() for name in ("u", "v", "w", "peak_ratio")}
                values["speed"] = float(np.sqrt(sum(values[name] ** 2 for name in "uvw")))
                for name, value in values.items():
                    assert same(said[NAMES[name]], value), (name, said, value)
                for name in "uvw":
                    assert float(said[f"{name}_std"]) == pytest.approx(one[f"{name}_std"].item(), rel=0.06)
    assert len(seen) > 30
    assert {selector for _, selector, *_ in seen} == {"#slices", "#scene"}


def test_mean_and_rms_are_those_of_all_valid_vectors(five, truth):
    statistics = SeriesStatistics(truth.isel(time=[0]))
    for k in range(5):
        statistics.add(truth.isel(time=[k]))
    wanted, made = statistics.result(), five()
    for kind in ("mean", "rms"):
        made.slide("#scene [data-control=moment]", kind)
        assert made.page.eval_on_selector("#slices [data-control=moment]", "e => e.value") == kind
        assert made.page.is_disabled("#slices [data-control=time]")
        for share in PLACES[:3]:
            (i, j, k), said, text = pointed(made, "#slices", share)
            assert text.count("RMS of") == (3 if kind == "rms" else 0)
            for name in "uvw":
                value = wanted[f"{name}_{kind}"].isel(x=i, y=j, z=k).item()
                assert same(said[name], value), (name, said, value)


def test_the_slider_over_time_moves_scene_and_slices_together(five):
    made, seen = five(), []
    assert "pair 1 of 5, t = 0 s" in made.page.inner_text("#scene [data-said=time]")
    for time in range(5):
        made.slide("#scene [data-control=time]", time)
        texts = {made.page.inner_text(f"{viewer} [data-said=time]") for viewer in ("#scene", "#slices")}
        assert texts == {f"pair {time + 1} of 5, t = {0.02 * time:g} s"}
        seen.append((made.colours("#scene .solid")[1], made.colours("#slices canvas")[1]))
    assert len({scene for scene, _ in seen}) == len({slices for _, slices in seen}) == 5
    assert made.page.get_attribute("#scene", "data-triangles") != "0"
    made.slide("#scene [data-control=time]", 1)  # set aside: nothing to draw, and no complaint
    assert made.page.get_attribute("#scene", "data-triangles") == "0"
    assert made.complaints == []


@pytest.mark.parametrize("viewer", ["#scene", "#slices"])
def test_every_quantity_has_colours_of_its_own(five, viewer):
    made = five()
    canvas = f"{viewer} .solid" if viewer == "#scene" else f"{viewer} canvas"
    bar = f"{viewer} .flat" if viewer == "#scene" else canvas
    names = made.page.eval_on_selector_all(f"{viewer} [data-control=colour] option", "all => all.map(o => o.value)")
    assert names == ["speed", "u", "v", "w", "error", "peak_ratio", "vorticity", "q", "divergence"]
    seen, labels = set(), set()
    for name in names:
        made.slide(f"{viewer} [data-control=colour]", name)
        seen.add(made.colours(canvas)[1])
        labels.add(made.page.eval_on_selector(bar, "canvas => canvas.written[canvas.written.length - 1][4]"))
    assert len(seen) == 9
    if viewer == "#scene":
        assert {"speed (m/s)", "error bar (m/s)", "Q-criterion (1/s²)", "peak ratio"} < labels
    made.slide(f"{viewer} [data-control=moment]", "rms")
    assert made.page.eval_on_selector(f"{viewer} [data-control=colour]", "choice => choice.value") == "speed"
    assert made.page.is_disabled(f"{viewer} [data-control=colour] option[value=q]")
    assert made.complaints == []


def test_a_constant_component_is_no_end_of_the_colours(five):
    """v is 0.31 m/s everywhere: the middle of its colours, and a share that a hand can change."""
    made = five()
    made.slide("#slices [data-control=colour]", "v")
    shares = """() => { const f = plenopiv.field, { low, high } = f.quantities.v.limits;
      return [...f.values.v].filter(Number.isFinite).map((v) => (v - low) / (high - low)); }"""
    assert made.page.evaluate(shares) == pytest.approx([0.5] * 377, abs=0.01)
    before = made.colours("#slices canvas")[1]
    made.slide("#slices [data-control=low]", "0.3")
    made.slide("#slices [data-control=high]", "0.311")
    assert made.colours("#slices canvas")[1] != before


def test_colours_differ_on_a_dark_page(five):
    middle = "document.querySelector('#slices canvas').getContext('2d').getImageData(100, 100, 1, 1).data.join()"
    seen = set()
    for scheme in ("light", "dark"):
        made = five(scheme=scheme)
        for name in ("u", "speed"):
            made.slide("#slices [data-control=colour]", name)
            seen.add(made.page.evaluate(middle))
    assert len(seen) == 4


def test_a_sub_volume_is_drawn_alone(five, truth):
    made = five()
    whole = int(made.page.get_attribute("#scene", "data-triangles"))
    made.page.click("#scene summary")
    made.slide("#scene [data-control=first-x]", 5)
    made.slide("#scene [data-control=last-y]", 2)
    for axis, first, last in (("x", 5, 8), ("y", 0, 2)):
        text = made.page.inner_text(f"#scene [data-said=part-{axis}]").replace("−", "-")
        ends = [float(part) for part in re.fullmatch(rf"{axis} = (.*) to (.*) mm", text).groups()]
        assert ends == pytest.approx(truth[axis].values[[first, last]].tolist(), abs=0.0051)
    assert 0 < int(made.page.get_attribute("#scene", "data-triangles")) < whole
    found = [found for share in PLACES if (found := pointed(made, "#scene", share))]
    assert found
    assert all(i >= 5 and j <= 2 for (i, j, _), *_ in found)
    made.slide("#scene [data-control=first-x]", 8)  # beyond what is left: two planes stay
    made.slide("#scene [data-control=last-x]", 0)
    assert made.page.inner_text("#scene [data-said=part-x]").endswith("mm")
    assert made.complaints == []


@pytest.mark.parametrize("name", ["volume", "views", "refocus"])
def test_images_change_with_black_white_gamma_and_zoom(go, reports, name):
    made = go(reports("rotation"))
    canvas, seen = f"#{name} canvas", []

    def look():
        seen.append(made.colours(canvas)[1])

    look()
    made.slide(f"#{name} [data-control=white]", 40)
    look()
    made.slide(f"#{name} [data-control=black]", 10)
    look()
    made.slide(f"#{name} [data-control=gamma]", 220)
    look()
    whole = [float(edge) for edge in made.page.get_attribute(f"#{name}", "data-part").split(",")]
    made.page.click(f"#{name} [data-control=nearer]")
    look()
    part = [float(edge) for edge in made.page.get_attribute(f"#{name}", "data-part").split(",")]
    assert part[1] - part[0] == pytest.approx((whole[1] - whole[0]) / 1.6)
    assert part[3] - part[2] == pytest.approx((whole[3] - whole[2]) / 1.6)
    made.page.locator(canvas).scroll_into_view_if_needed()
    box = made.page.locator(canvas).bounding_box()
    made.page.mouse.move(box["x"] + 150, box["y"] + 100)
    made.page.mouse.down()
    made.page.mouse.move(box["x"] + 190, box["y"] + 110, steps=2)
    made.page.mouse.up()
    look()
    moved = [float(edge) for edge in made.page.get_attribute(f"#{name}", "data-part").split(",")]
    assert moved[0] < part[0]  # dragged to the right: what was left of it comes in
    assert moved[3] > part[3]
    assert len(set(seen)) == 6
    made.page.click(f"#{name} [data-control=whole]")
    assert [float(edge) for edge in made.page.get_attribute(f"#{name}", "data-part").split(",")] == whole
    assert made.page.inner_text(f"#{name} [data-said=gamma]") == "2.20"
    made.slide(f"#{name} [data-control=black]", 95)  # above white
    drawn = made.colours(canvas)[0]
    assert drawn > 2
    assert made.complaints == []


def test_panels_stand_side_by_side_or_one_below_the_other(five):
    first_row = """() => [...document.querySelectorAll("figure.panels")].map((figure) => {
      const boxes = [...figure.children].map((image) => image.getBoundingClientRect());
      return boxes.map((box) => box.top < boxes[0].bottom);
    })"""
    wide, narrow = (five(width).page.evaluate(first_row) for width in (1280, 390))
    assert len(wide) == len(narrow) > 3
    assert all(all(beside) for beside in wide)
    assert all(not any(beside[1:]) for beside in narrow)


def test_the_demo_is_small_and_seen_at_once(browser, reports):
    """At most 3 MB; scene, slices and images drawn within 2 s of the beginning, in the best of three."""
    path, seconds = reports("demo"), []
    assert path.stat().st_size < 3e6
    for _ in range(3):
        page = browser.new_page()
        page.goto(path.as_uri())
        seconds.append(page.evaluate("performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd") / 1e3)
        page.close()
    assert 0 < min(seconds) < 2
