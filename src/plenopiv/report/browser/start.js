// Start what the page holds, and draw it anew when its width, the mode of the screen, or paper asks for it.

const content = (id) => JSON.parse(document.getElementById(id).textContent);
const drawings = [];
window.plenopiv = { isosurface, turned }; // for tests and the curious

const fieldData = document.getElementById("field-data");
if (fieldData) {
  const field = openField(content("field-data"));
  window.plenopiv.field = field;
  const scene = document.getElementById("scene"), slices = document.getElementById("slices");
  if (scene) drawings.push(startScene(scene, field));
  if (slices) drawings.push(startSlices(slices, field));
}
for (const root of document.querySelectorAll(".stack")) drawings.push(startStack(root, content(`${root.id}-data`)));

const drawAll = () => drawings.forEach((draw) => draw());
let width = document.documentElement.clientWidth;
window.addEventListener("resize", () => {
  if (document.documentElement.clientWidth === width) return;
  width = document.documentElement.clientWidth;
  drawAll();
});
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
for (const [event, paper] of [["beforeprint", true], ["afterprint", false]])
  window.addEventListener(event, () => { printing = paper; drawAll(); });

// A viewer as PNG, its canvases one over the other.
for (const button of document.querySelectorAll('[data-control="save"]')) button.addEventListener("click", () => {
  const viewer = button.closest(".viewer"), canvases = [...viewer.querySelectorAll(".stage canvas")];
  const sheet = document.createElement("canvas");
  [sheet.width, sheet.height] = [canvases[0].width, canvases[0].height];
  const context = sheet.getContext("2d");
  context.fillStyle = palette().paper;
  context.fillRect(0, 0, sheet.width, sheet.height);
  for (const canvas of canvases) context.drawImage(canvas, 0, 0);
  sheet.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${viewer.id}.png`;
    link.click();
    URL.revokeObjectURL(link.href);
  });
});
