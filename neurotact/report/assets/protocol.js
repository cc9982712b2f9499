// The page of a protocol study: one point per configuration, tied to its row of the table.

const study = JSON.parse(document.getElementById("study-data").textContent);
const host = document.getElementById("plot"), table = document.getElementById("networks");
let plotly = null;

function rowOf(index) {
  return table.querySelector(`tr[data-cell="${index}"]`);
}

function choose(index) {
  study.chosen = index;
  for (const row of table.tBodies[0].rows) row.removeAttribute("aria-current");
  rowOf(index).setAttribute("aria-current", "true");
  reach(rowOf(index));
  if (plotly) redraw();
}

function seriesTrace(name, index) {
  const here = study.points.map((_, i) => i).filter((i) => study.points[i].series === name && study.points[i].y != null);
  const points = here.map((i) => study.points[i]);
  const colour = style(`--series-${index % SYMBOLS.length}`), open = index < SYMBOLS.length ? "" : "-open";
  return {
    type: "scatter", mode: "markers", name: plain(name), x: points.map((p) => p.x), y: points.map((p) => p.y), customdata: here,
    text: points.map((p) => plain(p.name)), hovertemplate: `<b>%{text}</b><br>${study.score}: %{y:.1f}<br>${study.cost}: %{x:,.4~g}<extra></extra>`,
    error_y: {
      type: "data", symmetric: false, arrayminus: points.map((p) => p.bar[0]), array: points.map((p) => p.bar[1]),
      color: colour, thickness: 1, width: 2,
    },
    cliponaxis: false,
    marker: {
      symbol: SYMBOLS[index % SYMBOLS.length] + open, color: colour, size: 10, opacity: 0.9,
      line: { width: open ? 1.6 : 0.5, color: open ? colour : style("--ground") },
    },
  };
}

function redraw() {
  const names = [...new Set(study.points.map((point) => point.series))];
  const traces = names.map(seriesTrace);
  const chosen = study.points[study.chosen];
  if (chosen && chosen.y != null) {
    traces.push({
      type: "scatter", mode: "markers", showlegend: false, hoverinfo: "skip", x: [chosen.x], y: [chosen.y],
      marker: { symbol: "circle-open", size: 21, color: style("--ink"), line: { width: 2.5 } },
    });
  }
  return draw(plotly, host, traces, {
    ...sharedLayout(host.clientWidth < 600),
    xaxis: { ...axisStyle(), title: { text: plain(study.cost), standoff: 8 }, type: study.log ? "log" : "linear" },
    yaxis: { ...axisStyle(), ...(study.whole == null ? {} : within(study.whole)), title: { text: plain(study.score) } },
  });
}

for (const part of document.querySelectorAll(".scripted")) part.hidden = false;
for (const link of document.querySelectorAll("a[data-picture]")) link.href = link.closest("figure").querySelector("img").src;
unfoldOnVisit();
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
