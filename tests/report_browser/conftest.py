"""A browser without a network, and reports in it. Run by ``make test-report`` alone."""

import shutil

import pytest
from reports import ALSO, MAKERS

ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",  # WebGL on the processor: no graphics card is needed
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # no name is found
    "--proxy-server=127.0.0.1:9",  # and no address answers
]
# Remembers what is written on each canvas, and where, until the canvas is cleared by a new width.
WATCH = """(() => {
  const width = Object.getOwnPropertyDescriptor(HTMLCanvasElement.prototype, "width");
  Object.defineProperty(HTMLCanvasElement.prototype, "width", {
    ...width,
    set(value) { this.written = []; width.set.call(this, value); },
  });
  const fill = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    const m = this.measureText(text), t = this.getTransform();
    const corners = [-m.actualBoundingBoxLeft, m.actualBoundingBoxRight].flatMap((dx) =>
      [-m.actualBoundingBoxAscent, m.actualBoundingBoxDescent].map((dy) =>
        [t.a * (x + dx) + t.c * (y + dy) + t.e, t.b * (x + dx) + t.d * (y + dy) + t.f]));
    const [xs, ys] = [0, 1].map((i) => corners.map((corner) => corner[i]));
    (this.canvas.written ||= []).push([Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys), text]);
    return fill.call(this, text, x, y);
  };
})();"""


@pytest.fixture(scope="session")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is missing: see make test-report")
    found = next(
        (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
    )
    if found is None:
        pytest.skip("no Chromium here: apt-get install chromium, or put a chromium on the path")
    with playwright.sync_playwright() as started:
        running = started.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield running
        running.close()


@pytest.fixture(scope="session")
def reports(tmp_path_factory):
    """A function that gives the path of a report by its name in ``MAKERS`` or ``ALSO``, made once."""
    made = {}

    def path(name):
        if name not in made:
            made[name] = (MAKERS | ALSO)[name](tmp_path_factory.mktemp(name))
        return made[name]

    return path


@pytest.fixture(params=MAKERS)
def report(request, reports, browser):
    """Each report in turn; without a browser none is made."""
    return reports(request.param)


class Visit:
    """A report in a page of some width and colour scheme; what the page complained of and asked for."""

    def __init__(self, browser, path, width, scheme):
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        self.page = context.new_page()
        self.complaints, self.requests, self.dialogs = [], [], []
        self.page.on("console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda r: None if r.url.startswith("data:") else self.requests.append(r.url))
        self.page.on("dialog", lambda dialog: (self.dialogs.append(dialog.message), dialog.dismiss()))
        self.page.add_init_script(WATCH)
        self.address = path.as_uri()
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

    def photograph(self, folder, name, tall=4000):
        """Save the page in pictures of ``tall`` pixels: of more than 8192 at once Chromium repeats the top."""
        folder.mkdir(parents=True, exist_ok=True)
        size = self.page.viewport_size
        self.page.set_viewport_size({"width": size["width"], "height": tall})
        height = self.page.evaluate("document.documentElement.scrollHeight")
        for k in range(-(-height // tall)):
            self.page.evaluate("top => window.scrollTo(0, top)", k * tall)
            self.page.screenshot(path=folder / f"{name}-{k + 1}.png")
        self.page.evaluate("window.scrollTo(0, 0)")
        self.page.set_viewport_size(size)

    def places(self, selector):
        """Three values of a slider: near its beginning, in its middle, near its end."""
        low, high = self.page.evaluate(
            "selector => ['min', 'max'].map(end => Number(document.querySelector(selector)[end]))", selector
        )
        return [round(low + share * (high - low)) for share in (0.1, 0.5, 0.9)]


@pytest.fixture
def go(browser):
    """A function that visits a page."""
    visits = []

    def visited(path, width=1280, scheme="light"):
        visits.append(Visit(browser, path, width, scheme))
        return visits[-1]

    yield visited
    for made in visits:
        made.page.context.close()


@pytest.fixture
def visit(go, report):
    """A function that visits the report, at some width and in some colour scheme."""
    return lambda width=1280, scheme="light": go(report, width, scheme)
