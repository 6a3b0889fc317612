// The velocity volume in 3D: triangles by WebGL, and over them axes and a colour bar on a flat canvas.

// Start the scene in `root`. Returns a function that draws it anew.
function startScene(root, field) {
  const canvas = root.querySelector("canvas.solid"), flat = root.querySelector("canvas.flat");
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    root.querySelector(".absent").hidden = false;
    return () => {};
  }
  const control = (name) => controlIn(root, name), say = (name, text) => sayIn(root, name, text);
  const program = linked(gl, FRAGMENT), pick = picker(gl);
  const camera = { yaw: -0.55, pitch: 0.4, zoom: 1 };
  const longest = field.longest || 1;
  const coloursAsked = colourControls(root, field, build);
  let buffers = [], part, ends, limits, middle, half, colours, view, turn, size, marked = null;

  // First and last planes of the part that is drawn, two at least where there are two.
  function partAsked() {
    const found = {};
    for (const axis of ["x", "y", "z"]) {
      const all = field.axes[axis], first = Number(control(`first-${axis}`).value);
      const last = Math.max(Number(control(`last-${axis}`).value), Math.min(first + 1, all.length - 1));
      found[axis] = [Math.min(first, Math.max(last - 1, 0)), last];
      const [low, high] = found[axis].map((n) => placed(all, n));
      say(`part-${axis}`, `${axis} = ${low} to ${high} mm`);
    }
    return found;
  }

  function build() {
    ends = partAsked();
    part = partOf(field, ends);
    limits = ["x", "y", "z"].map((a) => faces(part.axes[a]));
    middle = limits.map(([a, b]) => (a + b) / 2);
    half = Math.hypot(...limits.map(([a, b]) => (b - a) / 2)) || 1;
    colours = coloursAsked();
    const values = part.values[colours.name], parts = [];
    const of = (a, b, f) => colours.at(values[a] + f * (values[b] - values[a]));
    const criterion = field.criteria[control("criterion").value];
    const turns = criterion && criterion.name in part.values;
    if (turns) {
      const level = criterion.low + (criterion.high - criterion.low) * (control("level").value / 100);
      parts.push(surfaceSolid(part, criterion.name, level, of));
      say("level", `${shown(Number(level.toPrecision(3)))} ${criterion.unit}`);
    } else say("level", "");
    control("level").disabled = !turns;
    ["x", "y", "z"].forEach((axis, d) => {
      const slider = control(`slice-${axis}`), n = Number(slider.value);
      slider.disabled = !control(`show-${axis}`).checked;
      say(`slice-${axis}`, slider.disabled ? "off" : `${axis} = ${placed(field.axes[axis], n)} mm`);
      if (!slider.disabled && n >= ends[axis][0] && n <= ends[axis][1])
        parts.push(sliceSolid(part, d, n - ends[axis][0], of));
    });
    control("arrows").disabled = field.moment().kind === "rms"; // fluctuations have no direction
    if (control("arrows").checked && !control("arrows").disabled) {
      const every = Math.max(1, Math.ceil(Math.cbrt(part.values.u.length / 700)));
      const spacing = Math.min(...["x", "y", "z"].map((a) => part.axes[a]).filter((a) => a.length > 1)
        .map((a) => (a[a.length - 1] - a[0]) / (a.length - 1)));
      const reach = Math.max(0.09 * half, 1.4 * (Number.isFinite(spacing) ? spacing : 0) * every);
      parts.push(arrowSolid(part, every, reach, longest, of));
    }
    for (const { buffer } of buffers) gl.deleteBuffer(buffer);
    buffers = parts.filter((p) => p.at.length).map((solid) => loaded(gl, solid));
    root.dataset.triangles = buffers.reduce((sum, b) => sum + b.count / 3, 0);
    draw();
  }

  function draw() {
    const width = root.querySelector(".stage").clientWidth;
    const height = Math.round(Math.min(560, Math.max(340, 0.62 * width)));
    const ratio = window.devicePixelRatio || 1;
    size = [width, height];
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.width = width + "px";
    canvas.style.height = height + "px";
    const paper = palette().paper.match(/[0-9a-f]{2}/gi).map((c) => parseInt(c, 16) / 255);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    turn = turned(camera);
    const room = (width - 100) / width; // the colour bar stands on the right
    view = projected(turn, middle, half, width / height, camera.zoom, room);
    drawn(gl, program, buffers, view.matrix, turn);
    drawAxes();
  }

  function drawAxes() {
    const [width, height] = size, page = sharp(flat, height), m = view.matrix;
    const onPage = (p) => {
      const h = [0, 1, 3].map((r) => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
      return [((h[0] / h[2] + 1) / 2) * width, ((1 - h[1] / h[2]) / 2) * height];
    };
    const eye = middle.map((c, d) => c + EYE * half * turn[2][d]);
    boxAround(page.context, limits, onPage, eye);
    colourBar(page.context, { left: width - 108, width: 0, top: 24, height: height - 60 }, colours.map, colours.bar, colours.label);
    if (marked) ring(page.context, onPage(marked));
  }

  // The vector nearest to what is drawn under a place of the page.
  function find([x, y]) {
    const [width, height] = size;
    const far = pick(buffers, view.matrix, turn, [x, y], size);
    if (far === null) return null;
    const place = view.back((2 * x) / width - 1, 1 - (2 * y) / height, far);
    const vector = ["x", "y", "z"].map((axis, d) => ends[axis][0] + nearest(part.axes[axis], place[d]));
    return { vector, text: valuesAt(field, vector), at: ["x", "y", "z"].map((axis, d) => field.axes[axis][vector[d]]) };
  }

  pointing(flat, root, find, (found) => {
    marked = found && found.at;
    drawAxes();
  });
  turnable(flat, camera, () => {
    marked = null;
    draw();
  });
  momentControls(root, field, build);
  root.querySelectorAll("[data-control]").forEach((c) => {
    if (!["time", "moment", "colour", "low", "high", "save", "front"].includes(c.dataset.control)) c.addEventListener("input", build);
  });
  control("front").addEventListener("click", () => {
    Object.assign(camera, { yaw: 0, pitch: 0, zoom: 1 });
    draw();
  });
  build();
  return build;
}

// Index of the value of an axis that is nearest to a place.
function nearest(axis, place) {
  let best = 0;
  axis.forEach((value, n) => {
    if (Math.abs(value - place) < Math.abs(axis[best] - place)) best = n;
  });
  return best;
}

// A ring around the vector whose values are told.
function ring(context, [x, y]) {
  for (const [colour, wide] of [[palette().paper, 4], [palette().ink, 1.6]]) {
    context.strokeStyle = colour;
    context.lineWidth = wide;
    context.beginPath();
    context.arc(x, y, 6, 0, 2 * Math.PI);
    context.stroke();
  }
  context.lineWidth = 1;
}

// Mouse, touch and keys turn the scene; the wheel enlarges it while Ctrl is held, or the keys + and - do.
function turnable(canvas, camera, draw) {
  let from = null;
  const by = (yaw, pitch) => {
    camera.yaw += yaw;
    camera.pitch = Math.max(-1.57, Math.min(1.57, camera.pitch + pitch));
    draw();
  };
  const enlarge = (factor) => {
    camera.zoom = Math.min(8, Math.max(0.5, camera.zoom * factor));
    draw();
  };
  canvas.addEventListener("pointerdown", (e) => {
    from = [e.clientX, e.clientY];
    canvas.setPointerCapture(e.pointerId);
  });
  canvas.addEventListener("pointermove", (e) => {
    if (!from) return;
    by((e.clientX - from[0]) * 0.008, (e.clientY - from[1]) * 0.008);
    from = [e.clientX, e.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (from = null));
  canvas.addEventListener("wheel", (e) => {
    if (!e.ctrlKey) return;
    e.preventDefault();
    enlarge(Math.exp(-e.deltaY * 0.002));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => by(-0.1, 0), ArrowRight: () => by(0.1, 0), ArrowUp: () => by(0, -0.1), ArrowDown: () => by(0, 0.1),
    "+": () => enlarge(1.15), "-": () => enlarge(1 / 1.15),
  };
  canvas.addEventListener("keydown", (e) => {
    if (!keys[e.key]) return;
    e.preventDefault();
    keys[e.key]();
  });
}
