// Isosurface of values on a grid by marching tetrahedra: each cell is six tetrahedra about one of its diagonals
// (Kuhn's), alike in all cells, so that triangles of neighbouring cells meet without gaps.

const CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]];
const TETRAHEDRA = [[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]];

// `values` on axes {x, y, z} in mm, x running fastest. Returns {at, normal, ends, share}: triangle corners and unit
// normals as flat lists of x, y, z, and for each corner the two grid points it lies between and how far along.
function isosurface(values, axes, level) {
  const { x, y, z } = axes, nx = x.length, ny = y.length, nz = z.length;
  const steps = CORNERS.map(([i, j, k]) => i + nx * (j + ny * k));
  const at = [], normal = [], ends = [], share = [];
  const slope = gradient(values, axes);

  function corner(a, b) {
    const f = (level - values[a]) / (values[b] - values[a]);
    const place = (n) => [x[n % nx], y[Math.floor(n / nx) % ny], z[Math.floor(n / (nx * ny))]];
    const p = place(a), q = place(b), g = slope(a), h = slope(b);
    const n = g.map((c, i) => -(c + f * (h[i] - c))); // downhill: out of what is above the level
    const length = Math.hypot(...n) || 1;
    for (let i = 0; i < 3; i++) {
      at.push(p[i] + f * (q[i] - p[i]));
      normal.push(n[i] / length);
    }
    ends.push(a, b);
    share.push(f);
  }

  for (let k = 0; k < nz - 1; k++) for (let j = 0; j < ny - 1; j++) for (let i = 0; i < nx - 1; i++) {
    const first = i + nx * (j + ny * k);
    let sum = 0, above = 0;
    for (const step of steps) {
      sum += values[first + step];
      above += values[first + step] > level;
    }
    if (above === 0 || above === 8 || !Number.isFinite(sum)) continue;
    for (const tetrahedron of TETRAHEDRA) {
      const high = [], low = [];
      for (const c of tetrahedron) (values[first + steps[c]] > level ? high : low).push(first + steps[c]);
      if (high.length === 1) for (const b of low) corner(high[0], b);
      else if (high.length === 3) for (const a of high) corner(a, low[0]);
      else if (high.length === 2) {
        const [a, b] = high, [c, d] = low;
        for (const [p, q] of [[a, c], [a, d], [b, c], [a, d], [b, d], [b, c]]) corner(p, q);
      }
    }
  }
  return { at, normal, ends, share };
}

// Slope of the values at a grid point, by differences to its neighbours.
function gradient(values, { x, y, z }) {
  const sizes = [x.length, y.length, z.length], steps = [1, x.length, x.length * y.length], along = [x, y, z];
  return (n) => along.map((axis, d) => {
    const i = Math.floor(n / steps[d]) % sizes[d];
    const before = i > 0 ? 1 : 0, after = i < sizes[d] - 1 ? 1 : 0;
    const rise = values[n + after * steps[d]] - values[n - before * steps[d]];
    return Number.isFinite(rise) ? rise / (axis[i + after] - axis[i - before]) : 0;
  });
}
