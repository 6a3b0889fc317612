// The velocity field: its moments (times, mean, RMS), unpacked where they are looked at; colours; values as text.

const RMS_SPEED = "RMS of the velocity vector";
const COMPONENT = { x: "u", y: "v", z: "w" };

function bytesOf(text) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let k = 0; k < letters.length; k++) bytes[k] = letters.charCodeAt(k);
  return bytes;
}

// Numbers of a block: bytes, 32-bit floats, or 16 bits of a range with 65535 for NaN.
function unpacked({ kind, low, step, data }) {
  const bytes = bytesOf(data);
  if (kind === "u1") return bytes;
  const view = new DataView(bytes.buffer), wide = kind === "f4" ? 4 : 2, values = new Float32Array(bytes.length / wide);
  for (let k = 0; k < values.length; k++) {
    if (wide === 4) values[k] = view.getFloat32(4 * k, true);
    else {
      const n = view.getUint16(2 * k, true);
      values[k] = n === 65535 ? NaN : low + step * n;
    }
  }
  return values;
}

// Values by name, each made when it is first asked for.
function lazily(makers) {
  const found = {};
  for (const [name, make] of Object.entries(makers)) {
    let made;
    Object.defineProperty(found, name, { enumerable: true, get: () => (made ??= make()) });
  }
  return found;
}

function valuesOf(moment) {
  const makers = {};
  for (const [name, packed] of Object.entries(moment.values)) makers[name] = () => unpacked(packed);
  const length = (a, b, c) => found[a].map((v, n) => Math.hypot(v, found[b][n], found[c][n]));
  makers.speed = () => length("u", "v", "w");
  if (moment.values.u_std) makers.error = () => length("u_std", "v_std", "w_std");
  const found = lazily(makers);
  return found;
}

// The field with a present moment; `tell` those who draw it when another one is chosen.
function openField(data) {
  const field = { ...data, at: data.first, values: valuesOf(data.moments[data.first]), drawn: [] };
  field.moment = () => data.moments[field.at];
  field.times = data.moments.filter((m) => m.kind === "time").length;
  field.show = (at) => {
    if (at === field.at || !data.moments[at]) return;
    field.at = at;
    field.values = valuesOf(data.moments[at]);
    field.drawn.forEach((draw) => draw());
  };
  return field;
}

// The part of the field between first and last planes, {x: [first, last], ...}.
function partOf(field, ends) {
  const axes = {}, sizes = {};
  for (const axis of ["x", "y", "z"]) {
    axes[axis] = field.axes[axis].slice(ends[axis][0], ends[axis][1] + 1);
    sizes[axis] = field.axes[axis].length;
  }
  if (["x", "y", "z"].every((axis) => axes[axis].length === sizes[axis])) return { axes, values: field.values };
  const cut = (full) => {
    const part = new full.constructor(axes.x.length * axes.y.length * axes.z.length);
    let at = 0;
    for (let k = ends.z[0]; k <= ends.z[1]; k++) for (let j = ends.y[0]; j <= ends.y[1]; j++) {
      const row = sizes.x * (j + sizes.y * k);
      part.set(full.subarray(row + ends.x[0], row + ends.x[1] + 1), at);
      at += axes.x.length;
    }
    return part;
  };
  const makers = {};
  for (const name of Object.keys(field.values)) makers[name] = () => cut(field.values[name]);
  return { axes, values: lazily(makers) };
}

// Colours of a quantity at the present moment; `given` limits count where they are numbers.
function colouring(field, name, given) {
  const quantity = field.quantities[name];
  const found = (field.moment().kind === "rms" && quantity.rms) || quantity.limits;
  const bar = [found.low, found.high].map((limit, k) => (Number.isFinite(given[k]) ? given[k] : limit));
  if (!(bar[1] > bar[0])) bar.splice(0, 2, found.low, found.high);
  const map = field.maps[dark() ? "dark" : "light"][found.map];
  const at = (value) => (Number.isFinite(value) ? colourAt(map, (value - bar[0]) / (bar[1] - bar[0])) : null);
  return { map, bar, at, kind: found.map, label: quantity.label + (quantity.unit && ` (${quantity.unit})`) };
}

// A value as its colours' range asks: to a thousandth of it.
function written(field, name, value) {
  const { low, high } = field.quantities[name].limits;
  const digits = Math.max(0, Math.ceil(-Math.log10(high - low)) + 3);
  if (!Number.isFinite(value)) return "none";
  return (digits <= 9 ? value.toFixed(digits) : String(Number(value.toPrecision(4)))).replaceAll("-", "\u2212");
}

// A place along evenly spaced ones in mm, to a tenth of their distance where that is below .1 mm.
function placed(places, n) {
  const apart = places.length > 1 ? Math.abs(places[1] - places[0]) : 0;
  const digits = apart > 0 ? Math.min(12, Math.max(2, 1 - Math.floor(Math.log10(apart)))) : 2;
  return shown(Number(places[n].toFixed(digits)));
}

// All values of a vector, by its indices along x, y, z in the whole field.
function valuesAt(field, [i, j, k]) {
  const { axes, values, quantities } = field, n = i + axes.x.length * (j + axes.y.length * k);
  const place = ["x", "y", "z"].map((a, d) => `${a} = ${placed(axes[a], [i, j, k][d])}`).join(", ");
  const rms = field.moment().kind === "rms", said = [];
  for (const name of ["u", "v", "w"]) {
    const std = values[`${name}_std`];
    const error = std && Number.isFinite(std[n]) ? ` \u00b1 ${Number(std[n].toPrecision(2))}` : "";
    said.push(`${rms ? "RMS of " : ""}${name} = ${written(field, name, values[name][n])}${error} m/s`);
  }
  for (const [name, { label, unit }] of Object.entries(quantities)) {
    if (["u", "v", "w"].includes(name) || !(name in values)) continue;
    said.push(`${rms && name === "speed" ? RMS_SPEED : label} ${written(field, name, values[name][n])}${unit && ` ${unit}`}`);
  }
  const state = values.inside_body && values.inside_body[n] === 1 ? "inside the body"
    : values.valid[n] === 1 ? "" : Number.isFinite(values.u[n]) ? "replaced" : "not measured";
  return `${place} mm: ${said.join("; ")}${state && `; ${state}`}`;
}
