// A stack of pictures (planes of the volume, depths of refocusing, views of the light field) under a slider, their
// brightness, and the part of them that is shown.

const NEAREST = 16; // times

function startStack(root, stack) {
  const canvas = root.querySelector("canvas"), control = (name) => controlIn(root, name), slider = control("place");
  const pictures = stack.pictures.map((source) => {
    const picture = new Image();
    picture.addEventListener("load", () => { if (pictures[slider.value] === picture) draw(); });
    picture.src = source;
    return picture;
  });
  const { x, y, limits } = stack, whole = [x[0], x[1], y[0], y[1]];
  let part = [...whole], box, shades, from = null;

  // What is black and white, as shares of the grey scale, and gamma.
  function tone() {
    const [black, white, gamma] = ["black", "white", "gamma"].map((name) => control(name).value / 100);
    return { black: Math.min(black, white - 0.01), white, gamma };
  }

  // The picture as a canvas, its grey values changed by these; its own values are kept for the pointer.
  function toned(picture) {
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [picture.naturalWidth, picture.naturalHeight];
    const context = copy.getContext("2d", { willReadFrequently: true });
    context.drawImage(picture, 0, 0);
    const image = context.getImageData(0, 0, copy.width, copy.height);
    shades = { width: copy.width, height: copy.height, values: image.data.filter((_, k) => k % 4 === 0) };
    const { black, white, gamma } = tone();
    const share = (n) => Math.min(Math.max((n / 255 - black) / (white - black), 0), 1);
    const table = Array.from({ length: 256 }, (_, n) => Math.round(255 * share(n) ** (1 / gamma)));
    for (let k = 0; k < image.data.length; k += 4)
      for (let c = 0; c < 3; c++) image.data[k + c] = table[image.data[k + c]];
    context.putImageData(image, 0, 0);
    return copy;
  }

  function draw() {
    const n = Number(slider.value), { black, white, gamma } = tone();
    const counts = [black, white].map((part) => limits[1] * part);
    sayIn(root, "place", stack.captions[n]);
    ["black", "white"].forEach((name, k) => sayIn(root, name, shown(Number(counts[k].toPrecision(3)))));
    sayIn(root, "gamma", gamma.toFixed(2));
    box = fitted(canvas.parentElement.clientWidth, x[1] - x[0], y[1] - y[0], 460);
    const { context } = sharp(canvas, box.total);
    if (pictures[n].complete && pictures[n].naturalWidth) {
      const picture = toned(pictures[n]), across = picture.width / (x[1] - x[0]), down = picture.height / (y[1] - y[0]);
      const source = [(part[0] - x[0]) * across, (y[1] - part[3]) * down, (part[1] - part[0]) * across, (part[3] - part[2]) * down];
      context.imageSmoothingEnabled = source[2] > box.width;
      context.drawImage(picture, ...source, box.left, box.top, box.width, box.height);
    }
    frame(context, box, part.slice(0, 2), part.slice(2), stack.labels);
    const grey = Array.from({ length: 33 }, (_, k) => Array(3).fill(255 * (k / 32) ** (1 / gamma)));
    colourBar(context, box, grey, counts, stack.unit);
    root.dataset.part = part.join();
  }

  // Show `factor` times less of the picture, the place [left, top] of the box staying where it is.
  function enlarge(factor, [left, top] = [0.5, 0.5]) {
    const most = (whole[1] - whole[0]) / (part[1] - part[0]) * factor;
    if (most > NEAREST) return;
    if (most <= 1) part = [...whole];
    else {
      const [px, py] = [part[0] + left * (part[1] - part[0]), part[3] - top * (part[3] - part[2])];
      part = part.map((edge, k) => (k < 2 ? px : py) + (edge - (k < 2 ? px : py)) / factor);
      move(0, 0);
    }
    draw();
  }

  // Move the part that is shown, within the picture.
  function move(right, up) {
    const bounded = (by, low, high, least, most) => Math.min(Math.max(by, least - low), most - high);
    const h = bounded(right, part[0], part[1], whole[0], whole[1]), v = bounded(up, part[2], part[3], whole[2], whole[3]);
    part = [part[0] + h, part[1] + h, part[2] + v, part[3] + v];
  }

  const shareOf = ([left, top]) => [(left - box.left) / box.width, (top - box.top) / box.height];

  function find(place) {
    const [a, b] = shareOf(place);
    if (a < 0 || a >= 1 || b < 0 || b >= 1 || !shades) return null;
    const mm = [part[0] + a * (part[1] - part[0]), part[3] - b * (part[3] - part[2])];
    const column = Math.floor(((mm[0] - x[0]) / (x[1] - x[0])) * shades.width);
    const row = Math.floor(((y[1] - mm[1]) / (y[1] - y[0])) * shades.height);
    const grey = shades.values[Math.min(row, shades.height - 1) * shades.width + Math.min(column, shades.width - 1)];
    const value = Number(((grey / 255) * limits[1]).toPrecision(2)), most = grey === 255 ? " or more" : "";
    const pixel = [(x[1] - x[0]) / shades.width, (y[1] - y[0]) / shades.height];
    const [h, v] = mm.map((c, k) => placed([c, c + pixel[k]], 0));
    return { text: `x = ${h}, y = ${v} mm: about ${shown(value)}${most} ${stack.unit.replace(/.*\((.*)\)/, "$1")}` };
  }

  canvas.addEventListener("wheel", (e) => {
    if (!e.ctrlKey) return;
    e.preventDefault();
    const edges = canvas.getBoundingClientRect();
    enlarge(Math.exp(-e.deltaY * 0.002), shareOf([e.clientX - edges.left, e.clientY - edges.top]));
  }, { passive: false });
  canvas.addEventListener("pointerdown", (e) => {
    from = [e.clientX, e.clientY];
    canvas.setPointerCapture(e.pointerId);
  });
  canvas.addEventListener("pointermove", (e) => {
    if (!from) return;
    move((-(e.clientX - from[0]) / box.width) * (part[1] - part[0]), ((e.clientY - from[1]) / box.height) * (part[3] - part[2]));
    from = [e.clientX, e.clientY];
    draw();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (from = null));
  pointing(canvas, root, find, () => {});
  for (const name of ["place", "black", "white", "gamma"]) control(name).addEventListener("input", draw);
  control("nearer").addEventListener("click", () => enlarge(1.6));
  control("farther").addEventListener("click", () => enlarge(1 / 1.6));
  control("whole").addEventListener("click", () => {
    part = [...whole];
    draw();
  });
  draw();
  return draw;
}
