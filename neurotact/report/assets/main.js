// The page's data, and the handlers of choices.

const study = JSON.parse(document.getElementById("study-data").textContent);
const byId = (id) => document.getElementById(id);
const host = byId("plot"), table = byId("networks");
const CHOICES = ["setting", "cost", "scale", "points", "kinds"];
let plotly = null;

/* Show a network: a point was clicked, or a row of the table was selected. */
function choose(index) {
  study.cell = index;
  const cell = study.cells[index];
  for (const row of table.tBodies[0].rows) row.removeAttribute("aria-current");
  rowOf(index).setAttribute("aria-current", "true");
  reach(rowOf(index));
  if (!belongs(study, cell)) {
    byId("setting").value = study.chosen.setting = cell.setting;
    settle();
  }
  showCell(cell, study);
  redraw();
}

function rowOf(index) {
  return table.querySelector(`tr[data-cell="${index}"]`);
}

function redraw() {
  if (plotly) drawTradeOff(plotly, host, study);
  keepInAddress({ ...study.chosen, without: [...study.without.pairs, ...study.without.sizes].join(" ") }, study.beginning);
}

/* Scroll and focus to the selected network. */
function lookAt(target) {
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  target.focus({ preventScroll: true });
  target.scrollIntoView({ behavior: still ? "auto" : "smooth", block: "start" });
}

/* The parts that depend on the data set: answer, table, and the networks to compare. */
function settle() {
  const front = study.fronts[study.chosen.setting];
  offerCosts();
  byId("kinds").parentElement.hidden = Boolean(front?.of);  // side by side each decides as it is used
  for (const part of document.querySelectorAll(".answer")) part.hidden = part.dataset.setting !== study.chosen.setting;
  const another = front?.networks.findIndex((_, i) => i !== front.best);
  const beside = front?.cheapest === front?.best && another >= 0 ? another : front?.cheapest;  // not a network with itself
  for (const [id, beginning] of [["one", front?.best], ["other", beside]]) {
    byId(id).replaceChildren(...(front?.networks ?? []).map((network, i) => element("option", { value: i }, network.name)));
    const asked = Number(study.chosen[id]);
    const at = study.chosen[id] !== "" && front?.networks[asked] ? asked : beginning;
    study.chosen[id] = study.chosen[id] === "" ? "" : String(at);
    byId(id).value = String(at);
  }
  if (front) byId("compared").replaceChildren(compareTable(front, Number(byId("one").value), Number(byId("other").value)));
}

/* The costs that are counted for networks of the data set; the first of them, in place of one that is not. */
function offerCosts() {
  const own = study.cells.filter((cell) => belongs(study, cell)), select = byId("cost");
  for (const option of select.options) {
    option.disabled = !own.some((cell) => cell.whole?.[option.value] != null);
    option.text = option.text.replace(/: not counted$/, "") + (option.disabled ? ": not counted" : "");
  }
  study.beginning.cost = [...select.options].find((option) => !option.disabled)?.value ?? "sops";
  if (select.selectedOptions[0].disabled) select.value = study.chosen.cost = study.beginning.cost;
}

function filterBoxes(id, values, without) {
  for (const value of values.map(String)) {
    const box = element("input", { type: "checkbox", ...(without.has(value) ? {} : { checked: "" }) });
    box.addEventListener("change", () => {
      box.checked ? without.delete(value) : without.add(value);
      redraw();
    });
    byId(id).append(element("label", {}, box, ` ${value}`));
  }
}

/* A choice by hand, which the address keeps even where the page begins with it: after another run it may not. */
function pick(id) {
  study.chosen[id] = byId(id).value;
  delete study.beginning[id];
  settle();
  redraw();
}

function begin() {
  const first = Object.keys(study.fronts)[0], all = study.fronts[first]?.of ? study.fronts[first] : null;  // encoders side by side
  study.beginning = { setting: all ? first : study.cells[study.best].setting, cost: all?.cost ?? "sops", scale: all?.scale ?? "linear", points: "means", kinds: "both", one: "", other: "", without: "" };
  const asked = stateOfAddress();
  const known = (id, value) => [...byId(id).options].some((option) => option.value === value);
  study.chosen = Object.fromEntries(CHOICES.map((id) => [id, known(id, asked.get(id)) ? asked.get(id) : study.beginning[id]]));
  Object.assign(study.chosen, { one: asked.get("one") ?? "", other: asked.get("other") ?? "" });
  const left = new Set((asked.get("without") ?? "").split(" "));
  study.without = { pairs: new Set(study.pairs.filter((pair) => left.has(pair))), sizes: new Set(study.architectures.filter((size) => left.has(size))) };
  for (const id of CHOICES) byId(id).value = study.chosen[id];
  for (const id of [...CHOICES, "one", "other"]) byId(id).addEventListener("change", () => pick(id));
  filterBoxes("pairs", study.pairs, study.without.pairs);
  filterBoxes("sizes", study.architectures, study.without.sizes);
  settle();
}

for (const part of document.querySelectorAll(".scripted")) part.hidden = false;
for (const link of document.querySelectorAll("a[data-picture]")) link.href = link.closest("figure").querySelector("img").src;
unfoldOnVisit();
sortable(table, byId("sorted"));
const reach = walkable(table.tBodies[0], (index) => {
  choose(index);
  lookAt(byId("cell-name"));
});
byId("to-row").addEventListener("click", () => {
  rowOf(study.cell).focus({ preventScroll: true });
  rowOf(study.cell).scrollIntoView({ block: "center" });
});
begin();
study.cell = study.best;
choose(belongs(study, study.cells[study.best]) ? study.best : study.cells.findIndex((cell) => belongs(study, cell)));

let width = byId("cell").clientWidth;
new ResizeObserver(() => {
  if (byId("cell").clientWidth === width) return;
  width = byId("cell").clientWidth;
  showCell(study.cells[study.cell], study);
  redraw();
}).observe(byId("cell"));
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

unpackPlotly().then((library) => {
  plotly = library;
  return drawTradeOff(plotly, host, study);
}).then(() => {
  host.on("plotly_click", (event) => {
    const index = event.points[0].customdata;
    if (index !== undefined && index >= 0) choose(index);
  });
}).catch((error) => {
  host.hidden = true;
  byId("plot-note").hidden = false;
  byId("plot-note").textContent =
    `This browser cannot draw the points (${error.message}); the table shows each network, and the figures below the trade-off.`;
});
