// Axes, ticks, colours and colour bars on a canvas: what every drawing of the page shares.

const LIGHT = { ink: "#1f2933", soft: "#5b6875", line: "#dde2e7", paper: "#ffffff" };
const FONT = '12px system-ui, "DejaVu Sans", sans-serif';
let printing = false; // paper is white, whatever the screen is

// Colours of the page in its present mode.
function palette() {
  if (printing) return LIGHT;
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(Object.keys(LIGHT).map((name) => [name, style.getPropertyValue("--" + name).trim()]));
}

// Whether the page is dark now.
const dark = () => !printing && window.matchMedia("(prefers-color-scheme: dark)").matches;

// A canvas made as sharp as the screen; its context draws in CSS pixels.
function sharp(canvas, height) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.parentElement.clientWidth;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  canvas.style.width = width + "px";
  canvas.style.height = height + "px";
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.font = FONT;
  return { context, width, height };
}

// Round numbers between two limits, about `count` of them, and two at least: one alone tells no scale.
function ticks(low, high, count) {
  const span = high - low;
  if (!(span > 0)) return [low];
  const raw = span / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(raw));
  const steps = [0.5, 1, 2, 5, 10].map((m) => m * power);
  const within = (step) => [Math.ceil(low / step - 1e-9), Math.floor(high / step + 1e-9)];
  let k = steps.findIndex((s, n) => n > 0 && s >= raw * 0.999);
  if (within(steps[k])[0] === within(steps[k])[1]) k -= 1;
  const [first, last] = within(steps[k]);
  return Array.from({ length: last - first + 1 }, (_, n) => (first + n) * steps[k]);
}

const shown = (value) => (Object.is(value, -0) ? 0 : Number(value.toPrecision(6))).toString().replace("-", "\u2212");

// A colour of a map, rows of [red, green, blue] from 0 to 255, at a share between 0 and 1.
function colourAt(map, share) {
  const place = Math.min(Math.max(share, 0), 1) * (map.length - 1);
  const k = Math.min(Math.floor(place), map.length - 2);
  return map[k].map((c, i) => c + (place - k) * (map[k + 1][i] - c));
}

const css = (colour) => `rgb(${colour.map(Math.round).join(",")})`;

// Where a picture of `across` x `up` mm fits into a canvas of some width, one scale for both axes.
function fitted(width, across, up, tallest) {
  const left = 58, top = 12, right = 104, bottom = 44;
  const scale = Math.min((width - left - right) / across, tallest / up);
  return { left, top, width: across * scale, height: up * scale, total: up * scale + top + bottom };
}

// Outer faces of cells around the vectors of an axis.
function faces(axis) {
  const half = axis.length > 1 ? (axis[axis.length - 1] - axis[0]) / (axis.length - 1) / 2 : 0.5;
  return [axis[0] - half, axis[axis.length - 1] + half];
}

// Frame, ticks and labels around a box of the canvas.
function frame(context, box, x, y, labels) {
  const { ink, soft } = palette();
  context.strokeStyle = soft;
  context.fillStyle = ink;
  context.lineWidth = 1;
  context.strokeRect(box.left, box.top, box.width, box.height);
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const value of ticks(x[0], x[1], box.width / 70)) {
    const at = box.left + ((value - x[0]) / (x[1] - x[0])) * box.width;
    line(context, at, box.top + box.height, at, box.top + box.height + 4);
    context.fillText(shown(value), at, box.top + box.height + 6);
  }
  context.fillText(labels[0], box.left + box.width / 2, box.top + box.height + 24);
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const value of ticks(y[0], y[1], box.height / 45)) {
    const at = box.top + ((y[1] - value) / (y[1] - y[0])) * box.height;
    line(context, box.left - 4, at, box.left, at);
    context.fillText(shown(value), box.left - 6, at);
  }
  upright(context, labels[1], box.left - 44, box.top + box.height / 2);
}

// A colour bar to the right of a box.
function colourBar(context, box, map, limits, label) {
  const { ink, soft } = palette();
  const left = box.left + box.width + 14, wide = 12;
  for (let k = 0; k < box.height; k++) {
    context.fillStyle = css(colourAt(map, 1 - k / Math.max(box.height - 1, 1)));
    context.fillRect(left, box.top + k, wide, 1.5);
  }
  context.strokeStyle = soft;
  context.strokeRect(left, box.top, wide, box.height);
  context.fillStyle = ink;
  context.textAlign = "left";
  context.textBaseline = "middle";
  let widest = 0;
  for (const value of ticks(limits[0], limits[1], box.height / 45)) {
    const at = box.top + ((limits[1] - value) / (limits[1] - limits[0])) * box.height;
    line(context, left + wide, at, left + wide + 4, at);
    context.fillText(shown(value), left + wide + 7, at);
    widest = Math.max(widest, context.measureText(shown(value)).width);
  }
  upright(context, label, left + wide + widest + 18, box.top + box.height / 2);
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

function upright(context, text, x, y) {
  context.save();
  context.translate(x, y);
  context.rotate(-Math.PI / 2);
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(text, 0, 0);
  context.restore();
}
