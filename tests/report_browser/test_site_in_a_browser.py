"""Pages of build/site/html (``make docs``) in a browser without a network: no error, nothing wider than the window."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HTML = ROOT / "build" / "site" / "html"
PAGES = sorted(path.relative_to(HTML).as_posix() for path in HTML.rglob("*.html") if "reports" not in path.parts)
SHOTS = ROOT / "build" / "screenshots" / "site"
SHOWN = ["index.html", "tutorial.html", "gallery.html", "notebooks/from-tiffs-to-vectors.html", "commands.html"]
SHOWN += ["experiment-file.html", "modules/velocity.html"]

pytestmark = pytest.mark.skipif(not PAGES, reason="no site here: make docs")


@pytest.fixture(scope="module")
def opened(browser):
    """A function that opens a page and gives it with what went wrong in it."""
    contexts = {}

    def page(name, width, scheme):
        if (width, scheme) not in contexts:
            size = {"width": width, "height": 900}
            contexts[width, scheme] = browser.new_context(viewport=size, color_scheme=scheme)
        page, wrong = contexts[width, scheme].new_page(), []
        page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("requestfailed", lambda request: wrong.append(request.url))
        page.on("request", lambda asked: wrong.append(asked.url) if asked.url.startswith("http") else None)
        page.goto((HTML / name).as_uri(), wait_until="load")
        return page, wrong

    yield page
    for context in contexts.values():
        context.close()


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("name", PAGES)
def test_it_opens_without_an_error_and_fits(opened, name, width):
    page, wrong = opened(name, width, "light")
    assert wrong == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("name", [name for name in SHOWN if name in PAGES])
def test_screenshots(opened, name, width, scheme):
    page, wrong = opened(name, width, scheme)
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name.replace('/', '-').removesuffix('.html')}-{width}-{scheme}.png")
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    light = sum(int(part) for part in dark.strip("rgba()").split(",")[:3]) / 3
    assert wrong == []
    assert (light < 90) == (scheme == "dark")
    page.close()


def test_search_finds_a_word(opened):
    page, wrong = opened("search.html", 1280, "light")
    page.goto((HTML / "search.html").as_uri() + "?q=orientation")
    page.wait_for_selector("#search-results li a", timeout=20_000)
    assert wrong == []


def test_a_report_of_the_gallery_is_live(opened):
    page, wrong = opened("gallery.html", 1280, "light")
    if not page.locator("iframe.report").count():
        pytest.skip("built without the gallery")
    for k in range(page.locator("iframe.report").count()):
        page.locator("iframe.report").nth(k).scroll_into_view_if_needed()
        page.frame_locator("iframe.report").nth(k).locator("canvas").first.wait_for(timeout=20_000)
    assert wrong == []
