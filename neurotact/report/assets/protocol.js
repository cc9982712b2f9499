// The page of a protocol study: one point per configuration, tied to its row of the table.

const study = JSON.parse(document.getElementById("study-data").textContent);
const host = document.getElementById("plot"), table = document.getElementById("networks");
const byId = (id) => document.getElementById(id);
const settings = Object.keys(study.fronts);
const COSTS = Object.keys(study.costs), CHOICES = ["setting", "cost", "scale"];
let plotly = null;

function costOf(point) {
  return point.costs[study.shown.cost];
}

function costHead() {
  return study.costs[study.shown.cost];
}

/* The scale on which a cost is shown first. */
function scaleOf(cost) {
  return study.log.includes(cost) ? "log" : "linear";
}

function rowOf(index) {
  return table.querySelector(`tr[data-cell="${index}"]`);
}

function choose(index) {
  study.chosen = index;
  const setting = study.points[index].setting;
  if (settings.length && study.shown.setting !== setting && settings.includes(setting)) show({ setting });
  for (const row of table.tBodies[0].rows) row.removeAttribute("aria-current");
  rowOf(index).setAttribute("aria-current", "true");
  reach(rowOf(index));
  if (plotly) redraw();
}

/* The answer, its table and its points: those of one setting. */
function show(changed) {
  Object.assign(study.shown, changed);
  for (const part of document.querySelectorAll(".answer")) part.hidden = part.dataset.setting !== study.shown.setting;
  if (changed.cost) study.shown.scale = changed.scale ?? scaleOf(changed.cost);
  for (const id of CHOICES) byId(id).value = study.shown[id];
  keepInAddress(study.shown, study.beginning);
}

/* Scores of which 1 is perfect, some much nearer to it than others: their distance from 1 has a logarithmic axis. */
function isBent() {
  const left = study.points.filter(isShown).map((point) => 1 - point.y);
  return study.whole == null && Math.min(...left) > 0 && Math.max(...left) > 30 * Math.min(...left);
}

/* The height of a score on the axis. */
function up(score) {
  return isBent() ? -Math.log10(Math.max(1 - score, 1e-6)) : score;
}

function bentTicks() {
  const scores = [-1, 0, 1, 2, 3, 4].flatMap((power) => [1, 0.5, 0.2].map((part) => 1 - part * 10 ** -power));
  return isBent() ? { tickvals: scores.map(up), ticktext: scores.map((score) => String(Number(score.toFixed(6)))) } : {};
}

function isShown(point) {
  return point.y != null && (!settings.length || point.setting === study.shown.setting);
}

/* Rings about the best configuration and the cheapest within its error. */
function markTraces() {
  const front = study.fronts[study.shown.setting];
  const both = front?.best === front?.cheapest;
  const of = study.points[front?.best]?.series.startsWith("network") ? " network" : "";  // chosen among networks, beside rivals
  const marks = !front ? [] : both ? [[`best and cheapest${of}`, front.best, 19]] : [[`best${of}`, front.best, 19], [`cheapest${of} within error`, front.cheapest, 21]];
  return marks.filter(([, index]) => costOf(study.points[index]) != null).map(([name, index, size]) => ({
    type: "scatter", mode: "markers", name, cliponaxis: false, hoverinfo: "skip", x: [costOf(study.points[index])], y: [up(study.points[index].y)],
    marker: { symbol: name.startsWith("best") ? "circle-open" : "square-open", size, color: style("--ink"), line: { width: 1.8 } },
  }));
}

/* The Pareto front of what is shown, from the cheapest point on. */
function frontTrace() {
  const points = study.points.filter((p) => isShown(p) && costOf(p) != null).sort((a, b) => costOf(a) - costOf(b) || b.y - a.y);
  let best = -Infinity;
  const front = points.filter((point) => point.y > best && ((best = point.y), true));
  return {
    type: "scatter", mode: "lines", name: "Pareto front", hoverinfo: "skip", x: front.map(costOf), y: front.map((p) => up(p.y)),
    line: { shape: "hv", dash: "dash", width: 1.2, color: style("--soft") },
  };
}

/* A line at guessing where it leaves the points room. */
function chanceLine() {
  const chance = study.fronts[study.shown.setting]?.chance, line = { y: chance, words: `guessing ${chance?.toFixed(1)}`, colour: style("--soft"), dash: "dot" };
  return near(chance == null ? [] : [line], study.points.filter(isShown).map((point) => point.y));
}

function seriesTrace(name, index) {
  const here = study.points.map((_, i) => i).filter((i) => study.points[i].series === name && isShown(study.points[i]));
  const points = here.map((i) => study.points[i]);
  const colour = style(`--series-${index % SYMBOLS.length}`), round = Math.floor(index / SYMBOLS.length), open = round % 4 === 1 || round % 4 === 2;
  return {
    type: "scatter", mode: "markers", name: plain(name), x: points.map(costOf), y: points.map((p) => up(p.y)), customdata: here,
    text: points.map((p) => `<b>${plain(p.name)}</b><br>${plain(study.score)}: ${short(p.y)}`), hovertemplate: `%{text}<br>${costHead()}: %{x:,.4~g}<extra></extra>`,
    error_y: {
      type: "data", symmetric: false, arrayminus: points.map((p) => up(p.y) - up(p.y - p.bar[0])), array: points.map((p) => up(p.y + p.bar[1]) - up(p.y)),
      color: colour, thickness: 1, width: 2,
    },
    cliponaxis: false,
    marker: {
      symbol: symbolOf(round < 2 ? index % SYMBOLS.length : index, open), color: colour, size: 10, opacity: 0.9,
      line: { width: open ? 1.6 : 0.5, color: open ? colour : style("--ground") },
    },
  };
}

function redraw() {
  const names = [...new Set(study.points.map((point) => point.series))];
  const traces = [...names.map(seriesTrace).filter((trace) => trace.x.length), frontTrace(), ...markTraces()];
  const chosen = study.points[study.chosen];
  if (chosen && isShown(chosen)) {
    traces.push({
      type: "scatter", mode: "markers", name: "selected", cliponaxis: false, hoverinfo: "skip", x: [costOf(chosen)], y: [up(chosen.y)],
      marker: { symbol: "circle-open", size: 14, color: style("--ink"), line: { width: 2.5 } },
    });
  }
  return draw(plotly, host, traces, {
    ...sharedLayout(host.clientWidth < 600),
    xaxis: { ...axisStyle(), title: { text: plain(costHead()), standoff: 8 }, type: study.shown.scale },
    yaxis: { ...axisStyle(), ...(study.whole == null ? {} : within(study.whole)), ...bentTicks(), title: { text: plain(study.score) } },
  }, chanceLine());
}

for (const part of document.querySelectorAll(".scripted")) part.hidden = false;
for (const link of document.querySelectorAll("a[data-picture]")) link.href = link.closest("figure").querySelector("img").src;
unfoldOnVisit();
study.beginning = { setting: settings[0] ?? "", cost: COSTS[0], scale: scaleOf(COSTS[0]) };
study.shown = { ...study.beginning };
if (settings.length) {
  const asked = stateOfAddress();
  show({
    setting: settings.includes(asked.get("setting")) ? asked.get("setting") : study.shown.setting,
    cost: COSTS.includes(asked.get("cost")) ? asked.get("cost") : study.shown.cost,
    ...(["linear", "log"].includes(asked.get("scale")) ? { scale: asked.get("scale") } : {}),
  });
  for (const id of CHOICES) byId(id).addEventListener("change", () => { show({ [id]: byId(id).value }); if (plotly) redraw(); });
}
sortable(table, document.getElementById("sorted"));
const reach = walkable(table.tBodies[0], choose);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plotly && redraw());

unpackPlotly().then((library) => {
  plotly = library;
  return redraw();
}).then(() => {
  host.on("plotly_click", (event) => {
    const index = event.points[0].customdata;
    if (index === undefined) return;
    choose(index);
    rowOf(index).scrollIntoView({ block: "nearest" });
  });
}).catch((error) => {
  host.hidden = true;
  const note = document.getElementById("plot-note");
  note.hidden = false;
  note.textContent = `This browser cannot draw the points (${error.message}); the table and the figures below show them.`;
});
