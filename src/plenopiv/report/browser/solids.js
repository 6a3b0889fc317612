// What the scene is made of, as triangles: positions, normals and colours, three numbers each for every corner.

const UNKNOWN = [128, 128, 128];

function solid() {
  return { at: [], normal: [], colour: [] };
}

function put(solid, at, normal, colour) {
  solid.at.push(...at);
  solid.normal.push(...normal);
  solid.colour.push(...(colour || UNKNOWN).map((c) => c / 255));
}

// The isosurface, in the colours of the velocity on it.
function surfaceSolid(field, name, level, colourOf) {
  const found = isosurface(field.values[name], field.axes, level);
  const made = solid();
  for (let c = 0; c < found.share.length; c++) {
    const [a, b] = [found.ends[2 * c], found.ends[2 * c + 1]];
    put(made, found.at.slice(3 * c, 3 * c + 3), found.normal.slice(3 * c, 3 * c + 3), colourOf(a, b, found.share[c]));
  }
  return made;
}

// A slice across axis d (0, 1, 2 for x, y, z) at grid index `at`: two triangles between four vectors.
function sliceSolid(field, d, at, colourOf) {
  const made = solid(), axes = [field.axes.x, field.axes.y, field.axes.z];
  const strides = [1, axes[0].length, axes[0].length * axes[1].length];
  const [p, q] = [0, 1, 2].filter((n) => n !== d);
  const facing = [0, 0, 0]; // no normal: lit from everywhere
  for (let j = 0; j < axes[q].length - 1; j++) for (let i = 0; i < axes[p].length - 1; i++) {
    const known = [[0, 0], [1, 0], [0, 1], [1, 1]].every(([k, l]) =>
      Number.isFinite(field.values.u[at * strides[d] + (i + k) * strides[p] + (j + l) * strides[q]]));
    if (!known) continue;
    for (const [k, l] of [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) {
      const place = [0, 0, 0];
      place[d] = axes[d][at];
      place[p] = axes[p][i + k];
      place[q] = axes[q][j + l];
      const n = at * strides[d] + (i + k) * strides[p] + (j + l) * strides[q];
      put(made, place, facing, colourOf(n, n, 0));
    }
  }
  return made;
}

// Arrows at every `every`-th vector along each axis; the longest is `reach` mm long.
function arrowSolid(field, every, reach, largest, colourOf) {
  const made = solid(), { x, y, z } = field.axes, { u, v, w } = field.values;
  const start = (size) => Math.floor(((size - 1) % every) / 2);
  for (let k = start(z.length); k < z.length; k += every)
    for (let j = start(y.length); j < y.length; j += every)
      for (let i = start(x.length); i < x.length; i += every) {
        const n = i + x.length * (j + y.length * k);
        const speed = Math.hypot(u[n], v[n], w[n]);
        if (!(speed > 0)) continue;
        const length = (Math.min(speed / largest, 1.5)) * reach;
        arrow(made, [x[i], y[j], z[k]], [u[n] / speed, v[n] / speed, w[n] / speed], length, 0.045 * reach, colourOf(n, n, 0));
      }
  return made;
}

// One arrow about its middle: a three-sided shaft and a four-sided head.
function arrow(made, middle, along, length, thick, colour) {
  const least = along.map(Math.abs).indexOf(Math.min(...along.map(Math.abs)));
  const side = unit(cross(along, [0, 1, 2].map((n) => +(n === least))));
  const other = cross(along, side);
  const point = (s, r, angle) => middle.map((c, n) => c + (s - 0.5) * length * along[n]
    + r * (Math.cos(angle) * side[n] + Math.sin(angle) * other[n]));
  const out = (angle) => side.map((c, n) => Math.cos(angle) * c + Math.sin(angle) * other[n]);
  const neck = Math.max(0.55, 1 - (5 * thick) / length);
  for (let f = 0; f < 3; f++) {
    const a = (2 * Math.PI * f) / 3, b = (2 * Math.PI * (f + 1)) / 3;
    for (const [s, angle] of [[0, a], [0, b], [neck, b], [0, a], [neck, b], [neck, a]])
      put(made, point(s, thick, angle), out(angle), colour);
  }
  for (let f = 0; f < 4; f++) {
    const a = (Math.PI * f) / 2, b = (Math.PI * (f + 1)) / 2;
    const wide = Math.min(2.6 * thick, 0.4 * length);
    for (const [s, r, angle] of [[neck, wide, a], [neck, wide, b], [1, 0, (a + b) / 2]])
      put(made, point(s, r, angle), out(angle), colour);
  }
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((c) => c / (Math.hypot(...a) || 1));
