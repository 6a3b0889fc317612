// A stack of pictures (planes of the volume, depths of refocusing, views of the light field) under a slider.

function startStack(root, stack) {
  const canvas = root.querySelector("canvas"), slider = root.querySelector("input");
  const pictures = stack.pictures.map((source) => {
    const picture = new Image();
    picture.addEventListener("load", () => { if (pictures[slider.value] === picture) draw(); });
    picture.src = source;
    return picture;
  });
  const grey = [[0, 0, 0], [255, 255, 255]];

  function draw() {
    const n = Number(slider.value), { x, y } = stack;
    root.querySelector('[data-said="place"]').textContent = stack.captions[n];
    const box = fitted(canvas.parentElement.clientWidth, x[1] - x[0], y[1] - y[0], 460);
    const { context } = sharp(canvas, box.total);
    context.imageSmoothingEnabled = pictures[n].naturalWidth > box.width;
    if (pictures[n].complete && pictures[n].naturalWidth)
      context.drawImage(pictures[n], box.left, box.top, box.width, box.height);
    frame(context, box, x, y, stack.labels);
    colourBar(context, box, grey, stack.limits, stack.unit);
  }

  slider.addEventListener("input", draw);
  draw();
  return draw;
}
