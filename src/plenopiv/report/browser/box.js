// The box around the volume with ticks in mm, drawn over the scene.

function boxAround(context, limits, onPage, eye) {
  const { ink, soft } = palette();
  const corner = (bits) => limits.map((limit, d) => limit[bits[d]]);
  const seen = limits.map(([low, high], d) => (eye[d] > high ? 1 : eye[d] < low ? 0 : null)); // which face, if any
  context.lineWidth = 1;
  for (let d = 0; d < 3; d++) for (const [p, q] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
    const bits = edge(d, p, q), others = [0, 1, 2].filter((n) => n !== d);
    if (others.every((n) => bits[n] === seen[n])) continue; // it would lie across what is inside
    const ends = [0, 1].map((end) => onPage(corner(bits.map((b, n) => (n === d ? end : b)))));
    context.strokeStyle = soft;
    context.globalAlpha = 0.6;
    line(context, ...ends[0], ...ends[1]);
    context.globalAlpha = 1;
  }
  context.fillStyle = ink;
  context.textBaseline = "middle";
  context.textAlign = "center";
  const middle = onPage(limits.map(([a, b]) => (a + b) / 2));
  const written = [];
  const { clientWidth: across, clientHeight: down } = context.canvas;
  const write = (text, [left, top]) => {
    const wide = context.measureText(text).width / 2 + 3;
    const x = Math.min(Math.max(left, wide), across - wide), y = Math.min(Math.max(top, 9), down - 9);
    if (Math.hypot(x - left, y - top) > 70) return; // its tick is far beyond the page
    if (written.some((w) => Math.abs(w.x - x) < w.wide + wide && Math.abs(w.y - y) < 15)) return;
    written.push({ x, y, wide });
    context.fillText(text, x, y);
  };
  for (let d = 0; d < 3; d++) {
    const [a, b] = outline(d, limits, onPage, seen);
    if (!a) continue; // seen end on
    const out = outward(a, b, middle), length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (length < 30) continue;
    const moved = (share, away) => [0, 1].map((i) => a[i] + share * (b[i] - a[i]) + away * out[i]);
    const title = `${"xyz"[d]} (mm)`, beside = moved(0.5, 34 + 18 * Math.abs(out[0])), top = a[1] < b[1] ? a : b;
    const room = beside[0] > context.measureText(title).width / 2;
    write(title, room ? beside : [top[0], top[1] - 12]); // on a narrow page above the axis
    const [low, high] = limits[d];
    for (const value of ticks(low, high, length / 45)) {
      const share = (value - low) / (high - low);
      line(context, ...moved(share, 0), ...moved(share, 5));
      write(shown(value), moved(share, 16));
    }
  }
}

function edge(d, p, q) {
  const bits = [p, q];
  bits.splice(d, 0, 0);
  return bits;
}

// Of the edges along axis d on the outline the lowest one (the leftmost, for y): nothing is drawn beyond it.
function outline(d, limits, onPage, seen) {
  let best = {};
  for (const [p, q] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
    const bits = edge(d, p, q), others = [0, 1, 2].filter((n) => n !== d);
    if (others.filter((n) => bits[n] === seen[n]).length !== 1) continue; // on the outline: one face seen, one not
    const [a, b] = [0, 1].map((end) => onPage(limits.map((limit, n) => limit[n === d ? end : bits[n]])));
    const score = d === 1 ? -(a[0] + b[0]) : a[1] + b[1];
    if (!(score <= best.score)) best = { a, b, score };
  }
  return [best.a, best.b];
}

// Unit vector on the page from a line, away from the middle.
function outward(a, b, middle) {
  const n = [b[1] - a[1], a[0] - b[0]], length = Math.hypot(...n) || 1;
  const side = n[0] * (a[0] - middle[0]) + n[1] * (a[1] - middle[1]) < 0 ? -1 : 1;
  return n.map((c) => (side * c) / length);
}
