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
  table.closest("details").open = true;
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
  const labels = point.labels[study.shown.setting];
  return point.y != null && (labels ? labelOf(point) != null : !settings.length || point.setting === study.shown.setting);
}

/* The name of a point in a picture that names points; empty without a name. */
function labelOf(point) {
  return point.labels[study.shown.setting]?.[study.shown.cost];
}

/* Whether all settings are shown together, what is drawn of each joined by a line. */
function isJoined() {
  return Boolean(study.fronts[study.shown.setting]?.is_joined);
}

/* Whether a point is one of those beside what has names. */
function isBeside(point) {
  return labelOf(point) === "" && !isJoined();
}

/* A line for each setting, between what is drawn of it. */
function joins() {
  return settings.map((setting) => study.points.filter((p) => p.setting === setting && isShown(p) && costOf(p) != null)).filter((pair) => pair.length > 1).map((pair) => ({
    type: "scatter", mode: "lines", showlegend: false, hoverinfo: "skip", x: pair.map(costOf), y: pair.map((p) => up(p.y)), line: { width: 1.2, color: style("--soft") }, name: pair[0].setting,
  }));
}

/* Whether the picture names points, beside which others are small and grey. */
function isNamed() {
  return study.points.some((point) => isShown(point) && labelOf(point));
}

/* Rings about the best configuration and the cheapest within its error. */
function markTraces() {
  const front = isNamed() ? null : study.fronts[study.shown.setting];
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

/* Entries of the legend alone, of a picture that names points. */
function keyTraces() {
  const entry = (name, colour, size) => ({ type: "scatter", mode: "markers", name, hoverinfo: "skip", x: [null], y: [null], marker: { color: style(colour), size } });
  return [entry(`named: ${study.fronts[study.shown.setting].named}`, "--ink", 10), entry("grey: others; zoom out for all", "--soft", 6)];
}

/* A line at guessing where it leaves the points room. */
function chanceLine() {
  const chance = study.fronts[study.shown.setting]?.chance, line = { y: chance, words: `guessing ${chance?.toFixed(1)}`, colour: style("--soft"), dash: "dot" };
  return near(chance == null ? [] : [line], study.points.filter((point) => isShown(point) && (!isNamed() || labelOf(point))).map((point) => point.y));
}

function seriesTrace(name, index, isOf = () => true) {
  const here = study.points.map((_, i) => i).filter((i) => study.points[i].series === name && isShown(study.points[i]) && isOf(study.points[i]));
  const points = here.map((i) => study.points[i]);
  const colour = style(`--series-${index % SYMBOLS.length}`), round = Math.floor(index / SYMBOLS.length), open = round % 4 === 1 || round % 4 === 2;
  return {
    type: "scatter", mode: "markers", name: plain(name), showlegend: !isNamed() || isJoined(), x: points.map(costOf), y: points.map((p) => up(p.y)), customdata: here,
    text: points.map((p) => `<b>${plain(p.name)}</b><br>${plain(study.score)}: ${short(p.y)}`), hovertemplate: `%{text}<br>${costHead()}: %{x:,.4~g}<extra></extra>`,
    error_y: {
      type: "data", symmetric: false, visible: !isNamed(), arrayminus: points.map((p) => up(p.y) - up(p.y - p.bar[0])), array: points.map((p) => up(p.y + p.bar[1]) - up(p.y)),
      color: colour, thickness: 1, width: 2,
    },
    cliponaxis: false,
    marker: {
      symbol: symbolOf(round < 2 ? index % SYMBOLS.length : index, open), size: points.map((p) => isBeside(p) ? 6 : 10), opacity: 0.9,
      color: points.map((p) => isBeside(p) ? style("--soft") : colour),
      line: { width: open ? 1.6 : 0.5, color: open ? colour : style("--ground") },
    },
  };
}

/* The part of an axis with the named points, with room for their names; of a logarithmic one by its powers. */
function rangeOf(values, least, type) {
  const known = type === "log" ? values.map(Math.log10) : values, low = Math.min(...known), high = Math.max(...known), room = 0.6 * Math.max(high - low, least);
  return { range: [type === "log" || low < 0 ? low - room : Math.max(0, low - room), high + room / 2], autorange: false };
}

function redraw() {
  const names = [...new Set(study.points.map((point) => point.series))];
  const named = study.points.filter((p) => isShown(p) && labelOf(p) && costOf(p) != null);
  const around = isJoined() ? study.points.filter((p) => isShown(p) && costOf(p) != null) : named;
  const layers = named.length && !isJoined() ? [(p) => !labelOf(p), labelOf] : [() => true];  // names lie on marks that lie over the others
  const traces = [...layers.flatMap((isOf) => names.map((name, index) => seriesTrace(name, index, isOf))).filter((trace) => trace.x.length), ...(isJoined() ? joins() : named.length ? keyTraces() : [frontTrace(), ...markTraces()])];
  const chosen = study.points[study.chosen];
  if (chosen && isShown(chosen)) {
    traces.push({
      type: "scatter", mode: "markers", name: "selected", cliponaxis: false, hoverinfo: "skip", x: [costOf(chosen)], y: [up(chosen.y)],
      marker: { symbol: "circle-open", size: 14, color: style("--ink"), line: { width: 2.5 } },
    });
  }
  const shared = sharedLayout(host.clientWidth < 600);
  return draw(plotly, host, traces, {
    ...shared, ...(named.length ? { margin: { ...shared.margin, t: 70 } } : {}),
    uirevision: JSON.stringify(study.shown),
    xaxis: { ...axisStyle(), ...(named.length ? rangeOf(around.map(costOf), 0, study.shown.scale) : {}), title: { text: plain(costHead()), standoff: 8 }, type: study.shown.scale },
    yaxis: { ...axisStyle(), ...(study.whole == null ? {} : within(study.whole)), ...(named.length ? rangeOf(around.map((p) => up(p.y)), 10, "linear") : {}), ...bentTicks(), title: { text: plain(study.score) } },
  }, chanceLine(), named.map((p) => ({ x: costOf(p), y: up(p.y), words: labelOf(p) })));
}

for (const part of document.querySelectorAll(".scripted")) part.hidden = false;
for (const link of document.querySelectorAll("a[data-picture]")) link.href = link.closest("figure").querySelector("img").src;
unfoldOnVisit();
const first = [...study.points.flatMap((point) => Object.values(point.labels).flatMap(Object.keys)), ...COSTS][0];
study.beginning = { setting: settings[0] ?? "", cost: first, scale: scaleOf(first) };
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
