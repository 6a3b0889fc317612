// WebGL of the scene: its two programs, buffers, the view, and what lies under a place of the page.

const EYE = 4.2; // distance of the eye from the middle, in half diagonals of the volume
const NEAR = EYE - 1.4, FAR = EYE + 1.4;
const VERTEX = `
attribute vec3 at; attribute vec3 normal; attribute vec3 colour;
uniform mat4 view; uniform mat3 turn;
varying vec3 tint; varying vec3 facing; varying float away;
void main() { gl_Position = view * vec4(at, 1.0); facing = turn * normal; tint = colour; away = gl_Position.w; }`;
const FRAGMENT = `
precision mediump float;
varying vec3 tint; varying vec3 facing;
void main() {
  float length2 = dot(facing, facing);
  float light = length2 < 0.25 ? 1.0 : 0.45 + 0.55 * abs(dot(normalize(facing), normalize(vec3(0.3, 0.5, 0.8))));
  gl_FragColor = vec4(tint * light, 1.0);
}`;
// The distance from the eye, spread over four bytes.
const DISTANCE = `
precision highp float;
varying float away;
void main() {
  float share = (away - ${NEAR.toFixed(2)}) / ${(FAR - NEAR).toFixed(2)};
  vec4 parts = fract(share * vec4(1.0, 255.0, 65025.0, 16581375.0));
  gl_FragColor = parts - parts.yzww * vec4(1.0 / 255.0, 1.0 / 255.0, 1.0 / 255.0, 0.0);
}`;

// Draw buffers of triangles with a program.
function drawn(gl, program, buffers, matrix, turn) {
  gl.useProgram(program.id);
  gl.uniformMatrix4fv(program.view, false, new Float32Array(matrix));
  gl.uniformMatrix3fv(program.turn, false, new Float32Array([0, 1, 2].flatMap((c) => turn.map((row) => row[c]))));
  for (const { buffer, count } of buffers) {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    [program.at, program.normal, program.colour].forEach((place, k) => {
      if (place < 0) return; // the program does not use it
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 36, 12 * k);
    });
    gl.drawArrays(gl.TRIANGLES, 0, count);
  }
}

// A picture of one pixel, into which what lies under the pointer is drawn. Returns a function that gives its distance
// from the eye, or null where nothing is.
function picker(gl) {
  const program = linked(gl, DISTANCE), frame = gl.createFramebuffer(), depth = gl.createRenderbuffer();
  const picture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, picture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
  gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT16, 1, 1);
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  return (buffers, matrix, turn, [x, y], [width, height]) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(-Math.floor(x), Math.floor(y) - height + 1, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    drawn(gl, program, buffers, matrix, turn);
    const p = new Uint8Array(4);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const share = (p[0] + p[1] / 255 + p[2] / 65025 + p[3] / 16581375) / 255;
    return share > 0 ? NEAR + share * (FAR - NEAR) : null;
  };
}

function linked(gl, fragment) {
  const id = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
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
  const wide = Math.min(1, aspect * room); // the volume must fit into the narrower of width and height
  const fill = aspect * room > 1.1 ? 1.05 : 0.86; // corners may leave the circle, labels may not leave the page
  const f = fill * Math.sqrt(EYE * EYE - 1) * zoom * wide;
  const rows = turn.map((row) => [...row.map((c) => c / half), -row.reduce((sum, c, i) => sum + (c * middle[i]) / half, 0)]);
  const depth = rows[2].map((c, i) => (i === 3 ? EYE - c : -c)); // distance from the eye
  const x = rows[0].map((c, i) => (f / aspect) * c - (1 - room) * depth[i]);
  const y = rows[1].map((c) => f * c);
  const z = depth.map((c, i) => ((FAR + NEAR) / (FAR - NEAR)) * c - (i === 3 ? (2 * FAR * NEAR) / (FAR - NEAR) : 0));
  // Where a place of the page (from -1 to 1) lies at some distance from the eye, along its axis.
  const back = (h, v, far) => {
    const p = [((h + 1 - room) * far * aspect) / f, (v * far) / f, EYE - far];
    return middle.map((c, i) => c + half * (p[0] * turn[0][i] + p[1] * turn[1][i] + p[2] * turn[2][i]));
  };
  return { matrix: [0, 1, 2, 3].flatMap((c) => [x[c], y[c], z[c], depth[c]]), back };
}
