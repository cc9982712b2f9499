// Accuracy against a cost, drawn by plotly: networks (means over seeds) or single seeds, their front, baseline, guessing.

const KINDS = {
  whole: { words: "whole window", dash: "solid", open: "" },
  early: { words: "early exit", dash: "dash", open: "-open" },
};
const COSTS = {
  sops: { words: "SOPs per decision", unit: "SOPs" }, ms: { words: "ms to decision", unit: "ms" },
  nJ: { words: "energy per decision, an estimate (nJ)", unit: "nJ" }, spikes: { words: "input spikes per decision", unit: "spikes" },
};

/* Whether a cell belongs to what is shown: a data set, or all encoders side by side, whose front says of which settings (`of`). */
function belongs(study, cell) {
  const { of } = study.fronts[study.chosen.setting] ?? {};
  return of ? cell.setting in of : cell.setting === study.chosen.setting;
}

/* The points: networks or single cells that are shown and pass the filters, each with its cell; a series is of one encoder or period. */
function pointsOf(study) {
  const { chosen } = study;
  const front = study.fronts[chosen.setting];
  const isShown = (point) => !study.without.pairs.has(point.pair) && !study.without.sizes.has(point.layers || String(point.hidden));
  if (chosen.points === "means") return front ? front.networks.map((n, i) => ({ ...n, at: i, series: n.series ?? n.pair })).filter(isShown) : [];
  return study.cells.map((cell, index) => ({ ...cell, cell: index, series: front?.of?.[cell.setting] ?? cell.pair }))
    .filter((cell) => belongs(study, cell) && isShown(cell));
}

/* Of encoders side by side each network decides as it is used. */
function drawable(points, kind, cost) {
  return points.filter((point) => point[kind]?.[cost] != null && (point.label == null || kind === point.used));
}

function pointTraces(study, points, kind, isFirst) {
  const { words, open } = KINDS[kind], cost = study.chosen.cost;
  const { of } = study.fronts[study.chosen.setting] ?? {};
  return (of ? [...new Set(Object.values(of))] : study.pairs).map((series, index) => {
    const here = drawable(points, kind, cost).filter((point) => point.series === series);
    const colour = style(`--series-${index % SYMBOLS.length}`);
    return {
      type: "scatter", mode: "markers", cliponaxis: false, name: plain(series), legendgroup: series, showlegend: here.length > 0 && isFirst && !of,
      x: here.map((p) => p[kind][cost]), y: here.map((p) => 100 * p[kind].accuracy), customdata: here.map((p) => p.cell),
      text: here.map((p) => plain(p.name) + (p.low == null || kind !== p.used ? "" : `<br>95 % interval ${(100 * p.low).toFixed(0)} to ${(100 * p.high).toFixed(0)} %`)),
      hovertemplate: `<b>%{text}</b><br>%{y:.1f} % accuracy, %{x:,.4~g} ${COSTS[cost].unit}<br>${words}<extra></extra>`,
      marker: {
        symbol: symbolOf(index, open), color: colour, opacity: 0.9,
        size: here.map((p) => p.label ? 12 : p.label === "" ? 7 : 9 + (6 * study.sizes.indexOf(p.hidden)) / Math.max(1, study.sizes.length - 1)),
        line: { width: open ? 1.6 : 0.5, color: open ? colour : style("--ground") },
      },
    };
  });
}

/* The Pareto front of accuracy and cost, from the cheapest point on. */
function frontOf(points, kind, cost) {
  const sorted = drawable(points, kind, cost).sort((a, b) => a[kind][cost] - b[kind][cost] || b[kind].accuracy - a[kind].accuracy);
  let best = -1;
  return sorted.filter((point) => point[kind].accuracy > best && ((best = point[kind].accuracy), true));
}

function frontTrace(study, points, kind) {
  const { words, dash } = KINDS[kind], cost = study.chosen.cost, front = frontOf(points, kind, cost);
  return {
    type: "scatter", mode: "lines", cliponaxis: false, name: `front, ${words}`, legendgroup: `front ${kind}`, hoverinfo: "skip",
    x: front.map((p) => p[kind][cost]), y: front.map((p) => 100 * p[kind].accuracy),
    line: { shape: "hv", dash, width: 1.5, color: style(kind === "whole" ? "--ink" : "--soft") },
  };
}

/* Rings around the compared networks and the selected one; the interval of the best one. */
function markTraces(study, points, kinds) {
  const cost = study.chosen.cost, ring = (point, size, colour) => {
    const shown = kinds.filter((kind) => drawable([point], kind, cost).length);
    return {
      type: "scatter", mode: "markers", cliponaxis: false, name: "selected network", hoverinfo: "skip", showlegend: !study.fronts[study.chosen.setting]?.of,
      x: shown.map((kind) => point[kind][cost]), y: shown.map((kind) => 100 * point[kind].accuracy),
      marker: { symbol: "circle-open", size, color: style(colour), line: { width: 2.5 } },
    };
  };
  const looked = points.filter((point) => point.cell === study.cell).map((point) => ring(point, 21, "--ink"));
  const front = study.fronts[study.chosen.setting], best = front?.networks[front.best];
  const used = best?.[front.used];
  if (study.chosen.points !== "means" || used?.[cost] == null || !kinds.includes(front.used) || !points.some((p) => p.at === front.best)) return looked;
  return [...looked, {
    type: "scatter", mode: "markers", cliponaxis: false, hoverinfo: "skip", name: "95 % interval of the best", x: [used[cost]], y: [100 * used.accuracy],
    marker: { symbol: "line-ns-open", size: 9, color: style("--ink"), line: { width: 1.4 } },
    error_y: { type: "data", symmetric: false, array: [100 * (best.high - used.accuracy)], arrayminus: [100 * (used.accuracy - best.low)], color: style("--ink"), thickness: 1.4, width: 5 },
  }];
}

/* Entries of the legend alone: what filled, open and larger marks are. */
function keyTraces(study, kinds) {
  const [least, most] = [study.sizes[0], study.sizes.at(-1)], front = study.fronts[study.chosen.setting];
  const entry = (name, symbol, size = 9) => ({
    type: "scatter", mode: "markers", name, hoverinfo: "skip", x: [null], y: [null],
    marker: { symbol, size, color: style("--soft"), line: { width: 1.6, color: style("--soft") } },
  });
  if (front?.of) return [entry("named: its best period on validation", "circle", 12), ...(front.networks.some((n) => n.label === "") ? [entry("small: its other periods", "circle", 7)] : [])];
  return [
    ...kinds.map((kind) => entry(`${kind === "whole" ? "filled" : "open"}: ${KINDS[kind].words}`, `circle${KINDS[kind].open}`)),
    ...(least < most ? [entry(`larger: more neurons (${least} to ${most})`, "circle", 13)] : []),
  ];
}

/* Lines at the rival that the verdict names and at guessing. */
function levels(front) {
  if (!front) return [];
  const found = [[front.guess, "guessing", "dot", "--soft"]];
  if (front.beside) found.push([front.beside.accuracy, front.beside.name, "dashdot", "--no"]);
  return found.map(([share, words, dash, colour]) => ({ y: 100 * share, words: `${plain(words)} ${percent(share)}`, dash, colour: style(colour) }));
}

/* What the rival costs, on its line; beside networks of one encoder the table tells it. */
function rivalTraces(study) {
  const { of, beside } = study.fronts[study.chosen.setting] ?? {};
  return !of || beside?.[study.chosen.cost] == null ? [] : [{
    type: "scatter", mode: "markers", cliponaxis: false, name: plain(beside.name), showlegend: false, hoverinfo: "name",
    x: [beside[study.chosen.cost]], y: [100 * beside.accuracy], marker: { symbol: "x", size: 10, color: style("--no") },
  }];
}

function drawTradeOff(plotly, host, study) {
  const { chosen } = study, kinds = chosen.kinds === "both" ? ["whole", "early"] : [chosen.kinds];
  const points = pointsOf(study);
  const traces = [
    ...kinds.filter(() => !study.fronts[chosen.setting]?.of).map((kind) => frontTrace(study, points, kind)),
    ...kinds.flatMap((kind, index) => pointTraces(study, points, kind, index === 0)),
    ...keyTraces(study, kinds),
    ...markTraces(study, points, kinds), ...rivalTraces(study),
  ];
  const labels = points.filter((p) => p.label && kinds.includes(p.used) && p[p.used]?.[chosen.cost] != null)
    .map((p) => ({ x: p[p.used][chosen.cost], y: 100 * p[p.used].accuracy, words: p.label }));
  const drawn = kinds.flatMap((kind) => drawable(points, kind, chosen.cost).map((p) => 100 * p[kind].accuracy));
  const isOfAll = Boolean(study.fronts[chosen.setting]?.of), lines = near(levels(study.fronts[chosen.setting]), drawn, isOfAll ? 0.3 : 2), ends = traces.filter((trace) => trace.error_y).flatMap(({ y, error_y: bar }) =>
    [{ y: y[0] - bar.arrayminus[0] }, { y: y[0] + bar.array[0] }]);
  const heights = [...drawn, ...[...lines, ...near(ends, drawn)].map((line) => line.y)], edge = 0.06 * (Math.max(...heights) - Math.min(...heights)) + 0.5;
  const low = Math.max(0, Math.min(...heights) - edge), high = Math.min(100, Math.max(...heights) + edge);
  const costs = kinds.flatMap((kind) => drawable(points, kind, chosen.cost).map((p) => p[kind][chosen.cost]));
  const isFromZero = chosen.scale === "linear" && Math.min(...costs) < 0.4 * Math.max(...costs);
  const narrow = host.clientWidth < 600, shared = sharedLayout(narrow);
  return draw(plotly, host, traces, {
    ...shared, height: (narrow ? 500 : 450) + 60 * isOfAll, margin: { ...shared.margin, t: isOfAll ? 90 : shared.margin.t },
    xaxis: { ...axisStyle(), title: { text: COSTS[chosen.cost].words, standoff: 8 }, type: chosen.scale, ...(isFromZero ? { rangemode: "tozero" } : {}) },
    yaxis: { ...axisStyle(), ...within(100), range: [low, high], title: { text: "test accuracy (%)" } },
    legend: isOfAll ? shared.legend : { ...shared.legend, title: { text: `${plain(study.pairWord).replace("t_ref", "t<sub>ref</sub>")} (ms) `, side: "top" } },
    uirevision: JSON.stringify([chosen.setting, chosen.cost, chosen.scale, chosen.kinds]),
  }, lines, labels);
}
