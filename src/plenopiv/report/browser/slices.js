// Vector slices: colour of one component or of the speed, arrows in the plane, crosses where vectors were replaced.

const PLANES = { z: ["x", "y"], y: ["x", "z"], x: ["z", "y"] }; // normal: right, up
const COMPONENT = { x: "u", y: "v", z: "w" };

function startSlices(root, field) {
  const canvas = root.querySelector("canvas");
  const control = (name) => root.querySelector(`[data-control="${name}"]`);
  const slider = control("place");

  function draw() {
    const normal = control("normal").value, [right, up] = PLANES[normal], axes = field.axes;
    const n = Number(slider.value), name = control("colour").value, top = field.largest[name] || 1;
    root.querySelector('[data-said="place"]').textContent = `${normal} = ${shown(Number(axes[normal][n].toFixed(2)))} mm`;
    const map = name === "speed" ? field.colours.speed : field.colours.component;
    const bar = name === "speed" ? [0, top] : [-top, top];
    const strides = { x: 1, y: axes.x.length, z: axes.x.length * axes.y.length };
    const number = (i, j) => n * strides[normal] + i * strides[right] + j * strides[up];
    const h = faces(axes[right]), v = faces(axes[up]);
    const box = fitted(canvas.parentElement.clientWidth, h[1] - h[0], v[1] - v[0], 460);
    const { context } = sharp(canvas, box.total + 22);
    const x = (mm) => box.left + ((mm - h[0]) / (h[1] - h[0])) * box.width;
    const y = (mm) => box.top + ((v[1] - mm) / (v[1] - v[0])) * box.height;
    const cell = [box.width / axes[right].length, box.height / axes[up].length];
    axes[right].forEach((a, i) => axes[up].forEach((b, j) => {
      const value = field.values[name][number(i, j)];
      if (!Number.isFinite(value)) return;
      context.fillStyle = css(colourAt(map, (value - bar[0]) / (bar[1] - bar[0])));
      context.fillRect(x(a) - cell[0] / 2, y(b) - cell[1] / 2, cell[0] + 0.6, cell[1] + 0.6);
    }));
    const every = Math.max(1, Math.ceil(18 / Math.min(...cell)));
    const longest = field.largest.speed || 1, reach = 1.5 * every * Math.min(...cell);
    context.lineWidth = 1.2;
    axes[right].forEach((a, i) => axes[up].forEach((b, j) => {
      const at = number(i, j);
      context.strokeStyle = context.fillStyle = name === "speed" ? "#ffffff" : "#1f2933";
      if (field.values.valid[at] !== 1) {
        line(context, x(a) - 3, y(b) - 3, x(a) + 3, y(b) + 3);
        line(context, x(a) - 3, y(b) + 3, x(a) + 3, y(b) - 3);
      }
      if (i % every || j % every) return;
      const along = [field.values[COMPONENT[right]][at], -field.values[COMPONENT[up]][at]];
      flatArrow(context, [x(a), y(b)], along.map((c) => (c / longest) * reach));
    }));
    frame(context, box, h, v, [`${right} (mm)`, `${up} (mm)`]);
    colourBar(context, box, map, bar, name === "speed" ? "speed (m/s)" : `${name} (m/s)`);
    key(context, box, longest, reach);
  }

  // How long an arrow of some round speed is.
  function key(context, box, longest, reach) {
    const speed = ticks(0, longest, 4).pop() || longest, at = box.top + box.height + 54;
    context.strokeStyle = context.fillStyle = palette().ink;
    const length = (speed / longest) * reach;
    flatArrow(context, [box.left + length / 2, at], [length, 0]);
    context.textAlign = "left";
    context.textBaseline = "middle";
    context.fillText(`${shown(speed)} m/s`, box.left + length + 8, at);
  }

  function fresh() {
    slider.max = field.axes[control("normal").value].length - 1;
    slider.value = Math.floor(field.axes[control("normal").value].length / 2);
    draw();
  }

  control("normal").addEventListener("input", fresh);
  control("colour").addEventListener("input", draw);
  slider.addEventListener("input", draw);
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
