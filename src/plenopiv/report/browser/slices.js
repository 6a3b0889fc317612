// Vector slices: colour of one quantity, arrows in the plane, crosses where vectors were replaced.

const PLANES = { z: ["x", "y"], y: ["x", "z"], x: ["z", "y"] }; // normal: right, up

function startSlices(root, field) {
  const canvas = root.querySelector("canvas"), control = (name) => controlIn(root, name);
  const slider = control("place"), coloursAsked = colourControls(root, field, draw);
  let drawn, marked = null;

  function draw() {
    const normal = control("normal").value, [right, up] = PLANES[normal], axes = field.axes, values = field.values;
    const n = Number(slider.value), colours = coloursAsked();
    sayIn(root, "place", `${normal} = ${placed(axes[normal], n)} mm`);
    const strides = { x: 1, y: axes.x.length, z: axes.x.length * axes.y.length };
    const number = (i, j) => n * strides[normal] + i * strides[right] + j * strides[up];
    const h = faces(axes[right]), v = faces(axes[up]);
    const box = fitted(canvas.parentElement.clientWidth, h[1] - h[0], v[1] - v[0], 460);
    const { context } = sharp(canvas, box.total + 22);
    const x = (mm) => box.left + ((mm - h[0]) / (h[1] - h[0])) * box.width;
    const y = (mm) => box.top + ((v[1] - mm) / (v[1] - v[0])) * box.height;
    const cell = [box.width / axes[right].length, box.height / axes[up].length];
    const shownValues = values[colours.name];
    axes[right].forEach((a, i) => axes[up].forEach((b, j) => {
      const colour = colours.at(shownValues[number(i, j)]);
      if (!colour) return;
      context.fillStyle = css(colour);
      context.fillRect(x(a) - cell[0] / 2, y(b) - cell[1] / 2, cell[0] + 0.6, cell[1] + 0.6);
    }));
    const every = Math.max(1, Math.ceil(18 / Math.min(...cell)));
    const longest = field.longest || 1, reach = 1.5 * every * Math.min(...cell);
    const light = colours.kind === "sequential" || dark(); // arrows on the colours of the maps' middle, with an edge
    const inks = light ? [["#1f2933", 2.6], ["#ffffff", 1.2]] : [["#ffffff", 2.6], ["#1f2933", 1.2]];
    const arrows = field.moment().kind !== "rms"; // fluctuations have no direction
    axes[right].forEach((a, i) => axes[up].forEach((b, j) => {
      const at = number(i, j), along = [values[COMPONENT[right]][at], -values[COMPONENT[up]][at]];
      for (const [colour, wide] of inks) {
        context.strokeStyle = context.fillStyle = colour;
        context.lineWidth = wide;
        if (values.valid[at] !== 1 && Number.isFinite(values.u[at])) {
          line(context, x(a) - 3, y(b) - 3, x(a) + 3, y(b) + 3);
          line(context, x(a) - 3, y(b) + 3, x(a) + 3, y(b) - 3);
        }
        if (arrows && !(i % every || j % every)) flatArrow(context, [x(a), y(b)], along.map((c) => (c / longest) * reach));
      }
    }));
    frame(context, box, h, v, [`${right} (mm)`, `${up} (mm)`]);
    colourBar(context, box, colours.map, colours.bar, colours.label);
    if (arrows) key(context, box, longest, reach);
    if (marked) ring(context, [x(axes[right][marked[0]]), y(axes[up][marked[1]])]);
    drawn = { normal, right, up, n, box, h, v };
  }

  // The vector whose cell lies under a place of the canvas.
  function find([left, top]) {
    const { normal, right, up, n, box, h, v } = drawn;
    const a = (left - box.left) / box.width, b = (top - box.top) / box.height;
    if (a < 0 || a > 1 || b < 0 || b > 1) return null;
    const i = nearest(field.axes[right], h[0] + a * (h[1] - h[0])), j = nearest(field.axes[up], v[1] - b * (v[1] - v[0]));
    const place = { [normal]: n, [right]: i, [up]: j }, vector = [place.x, place.y, place.z];
    return { vector, text: valuesAt(field, vector), at: [i, j] };
  }

  // How long an arrow of some round speed is.
  function key(context, box, longest, reach) {
    const speed = ticks(0, longest, 4).pop() || longest, at = box.top + box.height + 54;
    context.strokeStyle = context.fillStyle = palette().ink;
    context.lineWidth = 1.2;
    const length = (speed / longest) * reach;
    flatArrow(context, [box.left + length / 2, at], [length, 0]);
    context.textAlign = "left";
    context.textBaseline = "middle";
    context.fillText(`${shown(speed)} m/s`, box.left + length + 8, at);
  }

  function fresh() {
    slider.max = field.axes[control("normal").value].length - 1;
    slider.value = Math.floor(field.axes[control("normal").value].length / 2);
    marked = null;
    draw();
  }

  pointing(canvas, root, find, (found) => {
    if (String(marked) === String(found && found.at)) return;
    marked = found && found.at;
    draw();
  });
  control("normal").addEventListener("input", fresh);
  slider.addEventListener("input", draw);
  momentControls(root, field, draw);
  fresh();
  return draw;
}

function flatArrow(context, [x, y], [dx, dy]) {
  const length = Math.hypot(dx, dy);
  if (!(length > 0.5)) return;
  const [a, b] = [dx / length, dy / length], head = Math.min(5, 0.45 * length);
  const tip = [x + dx / 2, y + dy / 2], neck = [tip[0] - head * a, tip[1] - head * b];
  line(context, x - dx / 2, y - dy / 2, ...neck);
  context.beginPath();
  context.moveTo(...tip);
  context.lineTo(neck[0] - 0.5 * head * b, neck[1] + 0.5 * head * a);
  context.lineTo(neck[0] + 0.5 * head * b, neck[1] - 0.5 * head * a);
  context.fill();
}
