// Controls that several drawings share: which moment is shown, what is coloured and between which values.

const controlIn = (root, name) => root.querySelector(`[data-control="${name}"]`);

function sayIn(root, name, text) {
  const place = root.querySelector(`[data-said="${name}"]`);
  if (place && place.textContent !== text) place.textContent = text;
}

// Time slider and choice of mean or RMS in `root`; `draw` is called when they, or those of another drawing, change.
function momentControls(root, field, draw) {
  const slider = controlIn(root, "time"), choice = controlIn(root, "moment");
  field.drawn.push(() => {
    follow();
    draw();
  });
  function follow() {
    if (!slider) return;
    const { kind, label } = field.moment();
    choice.value = kind;
    slider.disabled = kind !== "time";
    if (kind === "time") slider.value = field.at;
    sayIn(root, "time", label);
    const colour = controlIn(root, "colour");
    for (const option of colour.options) option.disabled = !(option.value in field.values);
    if (colour.selectedOptions[0].disabled) colour.value = "speed";
  }
  if (!slider) return;
  const chosen = () => field.show(choice.value === "time" ? Number(slider.value)
    : field.moments.findIndex((m) => m.kind === choice.value));
  slider.addEventListener("input", chosen);
  choice.addEventListener("input", chosen);
  follow();
}

// The colours that the controls in `root` ask for. Another quantity begins with the limits of its data.
function colourControls(root, field, draw) {
  const colour = controlIn(root, "colour"), ends = ["low", "high"].map((name) => controlIn(root, name));
  colour.addEventListener("input", () => {
    ends.forEach((end) => (end.value = ""));
    draw();
  });
  ends.forEach((end) => end.addEventListener("input", draw));
  return () => {
    const colours = colouring(field, colour.value, ends.map((end) => (end.value === "" ? NaN : Number(end.value))));
    const rms = field.moment().kind === "rms" ? "RMS of " : "";
    const label = rms && colour.value === "speed" ? colours.label.replace("speed", RMS_SPEED) : rms + colours.label;
    ends.forEach((end, k) => (end.placeholder = shown(Number(colours.bar[k].toPrecision(3)))));
    return { ...colours, name: colour.value, label };
  };
}

// What is under the pointer, as text below a drawing. `find` gives {text, vector, draw} of a place on the canvas, or null.
function pointing(canvas, root, find, mark) {
  let waiting = false;
  const clear = () => {
    sayIn(root, "pointer", "Point at a place to read its values.");
    delete root.dataset.vector;
    mark(null);
  };
  const look = (e) => {
    if (waiting) return;
    waiting = true;
    const edges = canvas.getBoundingClientRect(), place = [e.clientX - edges.left, e.clientY - edges.top];
    requestAnimationFrame(() => {
      waiting = false;
      const found = find(place);
      if (!found) return clear();
      sayIn(root, "pointer", found.text);
      if (found.vector) root.dataset.vector = found.vector.join();
      mark(found);
    });
  };
  canvas.addEventListener("pointerdown", look); // a finger has no place before it touches
  canvas.addEventListener("pointermove", (e) => e.buttons || look(e));
  canvas.addEventListener("pointerleave", clear);
  return clear;
}
