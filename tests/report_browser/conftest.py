"""A browser without a network, and the demo's report in it. Run by ``make test-report`` alone."""

import os
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
REPORT = Path(os.environ.get("PLENOPIV_REPORT", ROOT / "demo" / "results" / "report.html")).resolve()
ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",  # WebGL on the processor: no graphics card is needed
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # no name is found
    "--proxy-server=127.0.0.1:9",  # and no address answers
]


@pytest.fixture(scope="session")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is missing: see make test-report")
    found = next(
        (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
    )
    if found is None:
        pytest.skip("no Chromium here: apt-get install chromium, or put a chromium on the path")
    if not REPORT.exists():
        pytest.skip(f"{REPORT} is missing: make demo, or name a report in PLENOPIV_REPORT")
    with playwright.sync_playwright() as started:
        running = started.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield running
        running.close()


class Visit:
    """A report in a page of some width and colour scheme; what the page complained of and asked for."""

    def __init__(self, browser, width, scheme, report=REPORT):
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        self.page = context.new_page()
        self.complaints, self.requests = [], []
        self.page.on("console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda r: None if r.url.startswith("data:") else self.requests.append(r.url))
        self.address = report.as_uri()
        self.page.goto(self.address)
        self.page.wait_for_function("[...document.images].every(image => image.complete)")
        self.page.wait_for_timeout(300)

    def colours(self, selector):
        """How many colours a canvas shows, and a number that changes with its content."""
        return self.page.evaluate(
            """selector => {
                 const canvas = document.querySelector(selector), copy = document.createElement("canvas");
                 [copy.width, copy.height] = [canvas.width, canvas.height];
                 const context = copy.getContext("2d");
                 context.drawImage(canvas, 0, 0);
                 const pixels = new Uint32Array(context.getImageData(0, 0, copy.width, copy.height).data.buffer);
                 let sum = 0;
                 for (const p of pixels) sum = (Math.imul(sum, 31) + p) | 0;
                 return [new Set(pixels).size, sum];
               }""",
            selector,
        )

    def slide(self, selector, value):
        """Move a slider, tick a box, or choose from a list, as a hand would tell it."""
        self.page.evaluate(
            """([selector, value]) => {
                 const input = document.querySelector(selector);
                 if (input.type === "checkbox") input.checked = value; else input.value = value;
                 input.dispatchEvent(new Event("input"));
               }""",
            [selector, value],
        )


@pytest.fixture
def visit(browser):
    visits = []

    def go(width=1280, scheme="light", report=REPORT):
        visits.append(Visit(browser, width, scheme, report))
        return visits[-1]

    yield go
    for made in visits:
        made.page.context.close()
