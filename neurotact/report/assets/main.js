// The page's data, and what happens when a network is chosen.

const study = JSON.parse(document.getElementById("study-data").textContent);
const byId = (id) => document.getElementById(id);
const host = byId("plot"), table = byId("networks");
let plotly = null;

function choose(index) {
  study.chosen = index;
  const cell = study.cells[index];
  for (const row of table.tBodies[0].rows) row.toggleAttribute("aria-current", Number(row.dataset.cell) === index);
  rowOf(index).setAttribute("aria-current", "true");
  reach(rowOf(index));
  if (study.setting !== "" && study.setting !== cell.setting) byId("setting").value = study.setting = cell.setting;
  showCell(cell, study);
  redraw();
}

function rowOf(index) {
  return table.querySelector(`tr[data-cell="${index}"]`);
}

function redraw() {
  if (plotly) drawTradeOff(plotly, host, study);
}

/* To the chosen network, for the keyboard and the eye alike. */
function lookAt(target) {
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  target.focus({ preventScroll: true });
  target.scrollIntoView({ behavior: still ? "auto" : "smooth", block: "start" });
}

for (const part of document.querySelectorAll(".scripted")) part.hidden = false;
for (const link of document.querySelectorAll("a[data-picture]")) link.href = link.closest("figure").querySelector("img").src;
sortable(table, byId("sorted"));
const reach = walkable(table.tBodies[0], (index) => {
  choose(index);
  lookAt(byId("cell-name"));
});
study.setting = study.cells[study.best].setting;
study.only = "both";
byId("setting").value = study.setting;
byId("setting").addEventListener("change", (event) => { study.setting = event.target.value; redraw(); });
byId("points").addEventListener("change", (event) => { study.only = event.target.value; redraw(); });
byId("to-row").addEventListener("click", () => {
  rowOf(study.chosen).focus({ preventScroll: true });
  rowOf(study.chosen).scrollIntoView({ block: "center" });
});
choose(study.best);

let width = byId("cell").clientWidth;
new ResizeObserver(() => {
  if (byId("cell").clientWidth === width) return;
  width = byId("cell").clientWidth;
  showCell(study.cells[study.chosen], study);
  redraw();
}).observe(byId("cell"));
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

unpackPlotly().then((library) => {
  plotly = library;
  return drawTradeOff(plotly, host, study);
}).then(() => {
  host.on("plotly_click", (event) => {
    const index = event.points[0].customdata;
    if (index !== undefined) choose(index);
  });
}).catch((error) => {
  host.hidden = true;
  byId("plot-note").hidden = false;
  byId("plot-note").textContent =
    `This browser cannot draw the points (${error.message}); the table shows each network, and the figures below the trade-off.`;
});
