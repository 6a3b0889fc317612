// The velocity volume in 3D: triangles by WebGL, and over them axes and a colour bar on a flat canvas.

const VERTEX = `
attribute vec3 at; attribute vec3 normal; attribute vec3 colour;
uniform mat4 view; uniform mat3 turn;
varying vec3 tint; varying vec3 facing;
void main() { gl_Position = view * vec4(at, 1.0); facing = turn * normal; tint = colour; }`;
const FRAGMENT = `
precision mediump float;
varying vec3 tint; varying vec3 facing;
void main() {
  float length2 = dot(facing, facing);
  float light = length2 < 0.25 ? 1.0 : 0.45 + 0.55 * abs(dot(normalize(facing), normalize(vec3(0.3, 0.5, 0.8))));
  gl_FragColor = vec4(tint * light, 1.0);
}`;
const EYE = 4.2; // distance of the eye from the middle, in half diagonals of the volume

// Start the scene in `root`; its field is {axes, values, colours, criteria}. Returns a function that draws it anew.
function startScene(root, field) {
  const canvas = root.querySelector("canvas.solid"), flat = root.querySelector("canvas.flat");
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    root.querySelector(".absent").hidden = false;
    return () => {};
  }
  const control = (name) => root.querySelector(`[data-control="${name}"]`);
  const program = linked(gl);
  const limits = ["x", "y", "z"].map((a) => faces(field.axes[a]));
  const middle = limits.map(([a, b]) => (a + b) / 2);
  const half = Math.hypot(...limits.map(([a, b]) => (b - a) / 2)) || 1;
  const camera = { yaw: -0.55, pitch: 0.4, zoom: 1 };
  const speed = field.values.speed;
  const largest = field.largest.speed || 1;
  let buffers = [];

  function colouring() {
    const name = control("colour").value, top = field.largest[name] || 1;
    const map = name === "speed" ? field.colours.speed : field.colours.component;
    const bar = name === "speed" ? [0, top] : [-top, top];
    const values = field.values[name];
    const of = (a, b, f) => colourAt(map, (values[a] + f * (values[b] - values[a]) - bar[0]) / (bar[1] - bar[0]));
    return { of, map, bar, label: name === "speed" ? "speed (m/s)" : `${name} (m/s)` };
  }

  function build() {
    const colour = colouring(), parts = [];
    const criterion = field.criteria[control("criterion").value];
    if (criterion) {
      const level = criterion.low + (criterion.high - criterion.low) * (control("level").value / 100);
      parts.push(surfaceSolid(field, criterion.name, level, colour.of));
      say("level", `${shown(Number(level.toPrecision(3)))} ${criterion.unit}`);
    } else say("level", "");
    control("level").disabled = !criterion;
    ["x", "y", "z"].forEach((axis, d) => {
      const slider = control(`slice-${axis}`), n = Number(slider.value);
      slider.disabled = !control(`show-${axis}`).checked;
      say(`slice-${axis}`, slider.disabled ? "off" : `${axis} = ${shown(Number(field.axes[axis][n].toFixed(2)))} mm`);
      if (!slider.disabled) parts.push(sliceSolid(field, d, n, colour.of));
    });
    if (control("arrows").checked) {
      const every = Math.max(1, Math.ceil(Math.cbrt(speed.length / 700)));
      const spacing = Math.min(...["x", "y", "z"].map((a) => field.axes[a]).filter((a) => a.length > 1)
        .map((a) => (a[a.length - 1] - a[0]) / (a.length - 1)));
      const reach = Math.max(0.09 * half, 1.4 * spacing * every);
      parts.push(arrowSolid(field, every, reach, largest, colour.of));
    }
    for (const { buffer } of buffers) gl.deleteBuffer(buffer);
    buffers = parts.filter((p) => p.at.length).map((part) => loaded(gl, part));
    root.dataset.triangles = buffers.reduce((sum, b) => sum + b.count / 3, 0);
    draw();
  }

  function say(name, text) {
    root.querySelector(`[data-said="${name}"]`).textContent = text;
  }

  function draw() {
    const width = root.querySelector(".stage").clientWidth;
    const height = Math.round(Math.min(560, Math.max(340, 0.62 * width)));
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.width = width + "px";
    canvas.style.height = height + "px";
    const paper = palette().paper.match(/[0-9a-f]{2}/gi).map((c) => parseInt(c, 16) / 255);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const turn = turned(camera), room = (width - 100) / width; // the colour bar stands on the right
    const view = projected(turn, middle, half, width / height, camera.zoom, room);
    gl.useProgram(program.id);
    gl.uniformMatrix4fv(program.view, false, new Float32Array(view));
    gl.uniformMatrix3fv(program.turn, false, new Float32Array([0, 1, 2].flatMap((c) => turn.map((row) => row[c]))));
    for (const { buffer, count } of buffers) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      [program.at, program.normal, program.colour].forEach((place, k) => {
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 36, 12 * k);
      });
      gl.drawArrays(gl.TRIANGLES, 0, count);
    }
    const page = sharp(flat, height);
    const onPage = (p) => {
      const h = [0, 1, 3].map((r) => view[r] * p[0] + view[4 + r] * p[1] + view[8 + r] * p[2] + view[12 + r]);
      return [((h[0] / h[2] + 1) / 2) * width, ((1 - h[1] / h[2]) / 2) * height];
    };
    const eye = middle.map((c, d) => c + EYE * half * turn[2][d]);
    boxAround(page.context, limits, onPage, eye);
    const colour = colouring();
    colourBar(page.context, { left: width - 108, width: 0, top: 24, height: height - 60 }, colour.map, colour.bar, colour.label);
  }

  turnable(flat, camera, draw);
  root.querySelectorAll("input, select").forEach((c) => c.addEventListener("input", build));
  root.querySelector('[data-control="front"]').addEventListener("click", () => {
    Object.assign(camera, { yaw: 0, pitch: 0, zoom: 1 });
    draw();
  });
  build();
  return draw;
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

function linked(gl) {
  const id = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(id, shader);
  }
  gl.linkProgram(id);
  const attribute = (name) => gl.getAttribLocation(id, name), uniform = (name) => gl.getUniformLocation(id, name);
  return { id, at: attribute("at"), normal: attribute("normal"), colour: attribute("colour"),
    view: uniform("view"), turn: uniform("turn") };
}

// Positions, normals and colours side by side in one buffer.
function loaded(gl, part) {
  const count = part.at.length / 3, mixed = new Float32Array(9 * count);
  for (let c = 0; c < count; c++) for (let i = 0; i < 3; i++) {
    mixed[9 * c + i] = part.at[3 * c + i];
    mixed[9 * c + 3 + i] = part.normal[3 * c + i];
    mixed[9 * c + 6 + i] = part.colour[3 * c + i];
  }
  const buffer = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, mixed, gl.STATIC_DRAW);
  return { buffer, count };
}

// Rows of the rotation from the object frame to the screen's: right, up, toward the eye. Unturned, the eye is where
// the recording camera is: x to the right, y up, z toward it.
function turned({ yaw, pitch }) {
  const [c, s, d, t] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return [[c, 0, s], [t * s, d, -t * c], [-d * s, t, d * c]];
}

// Column-major matrix of the view: turned about the middle, in perspective; x is drawn into `room` of the width.
function projected(turn, middle, half, aspect, zoom, room) {
  const near = EYE - 1.4, far = EYE + 1.4;
  const wide = Math.min(1, aspect * room); // the volume must fit into the narrower of width and height
  const fill = aspect * room > 1.1 ? 1.12 : 0.86; // corners may leave the circle, labels may not leave the page
  const f = fill * Math.sqrt(EYE * EYE - 1) * zoom * wide;
  const rows = turn.map((row) => [...row.map((c) => c / half), -row.reduce((sum, c, i) => sum + (c * middle[i]) / half, 0)]);
  const depth = rows[2].map((c, i) => (i === 3 ? EYE - c : -c)); // distance from the eye
  const x = rows[0].map((c, i) => (f / aspect) * c - (1 - room) * depth[i]);
  const y = rows[1].map((c) => f * c);
  const z = depth.map((c, i) => ((far + near) / (far - near)) * c - (i === 3 ? (2 * far * near) / (far - near) : 0));
  return [0, 1, 2, 3].flatMap((c) => [x[c], y[c], z[c], depth[c]]);
}
