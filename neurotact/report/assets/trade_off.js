// Accuracy against synaptic operations, drawn by plotly: one point per cell, and the fronts of means over seeds.

const KINDS = {
  full: { cost: "sops_total", gain: "accuracy_test", words: "full window", dash: "solid", open: "" },
  exit: { cost: "exit_sops_total", gain: "exit_accuracy", words: "early exit", dash: "dash", open: "-open" },
};

function pointTraces(study, cells, kind) {
  const { cost, gain, words, open } = KINDS[kind];
  return study.pairs.map((pair, index) => {
    const here = cells.filter((i) => study.cells[i].pair === pair && study.cells[i].row[gain] != null);
    const rows = here.map((i) => study.cells[i].row);
    return {
      type: "scatter", mode: "markers", cliponaxis: false, name: plain(pair), legendgroup: pair,
      showlegend: here.length > 0 && (kind === "full" || study.only === "exit"),
      x: rows.map((row) => row[cost]), y: rows.map((row) => 100 * row[gain]), customdata: here,
      text: here.map((i) => plain(study.cells[i].name)),
      hovertemplate: `<b>%{text}</b><br>%{y:.1f} % accuracy, %{x:,.0f} SOPs<br>${words}<extra></extra>`,
      marker: {
        symbol: SYMBOLS[index % SYMBOLS.length] + open, color: style(`--series-${index % SYMBOLS.length}`), opacity: 0.9,
        size: rows.map((row) => 9 + (6 * study.sizes.indexOf(row.hidden)) / Math.max(1, study.sizes.length - 1)),
        line: { width: open ? 1.6 : 0.5, color: style(open ? `--series-${index % SYMBOLS.length}` : "--ground") },
      },
    };
  });
}

function frontTraces(study, settings, kind) {
  const { words, dash } = KINDS[kind];
  return settings.map((setting, index) => {
    const front = study.fronts[setting][kind];
    return {
      type: "scatter", mode: "lines+markers", cliponaxis: false, name: `Pareto front, ${words}`, legendgroup: `front ${kind}`, showlegend: index === 0,
      x: front.map((network) => network.sops), y: front.map((network) => 100 * network.accuracy),
      text: front.map((network) => `${plain(network.name)}, mean of ${network.seeds} seed${network.seeds > 1 ? "s" : ""}`),
      hovertemplate: `<b>%{text}</b><br>%{y:.1f} % accuracy, %{x:,.0f} SOPs<br>Pareto front, ${words}<extra></extra>`,
      marker: { symbol: "circle", size: 5, color: style(kind === "full" ? "--ink" : "--soft") },
      line: { shape: "hv", dash, width: 1.5, color: style(kind === "full" ? "--ink" : "--soft") },
    };
  });
}

function chosenTrace(study, kinds) {
  const row = study.cells[study.chosen].row;
  const shown = kinds.filter((kind) => row[KINDS[kind].gain] != null);
  return {
    type: "scatter", mode: "markers", cliponaxis: false, name: "chosen", showlegend: false, hoverinfo: "skip",
    x: shown.map((kind) => row[KINDS[kind].cost]), y: shown.map((kind) => 100 * row[KINDS[kind].gain]),
    marker: { symbol: "circle-open", size: 21, color: style("--ink"), line: { width: 2.5 } },
  };
}

function drawTradeOff(plotly, host, study) {
  const kinds = study.only === "both" ? ["full", "exit"] : [study.only];
  const settings = study.setting === "" ? Object.keys(study.fronts) : [study.setting];
  const cells = study.cells.map((_, i) => i).filter((i) => settings.includes(study.cells[i].setting));
  const traces = [
    ...kinds.flatMap((kind) => frontTraces(study, settings, kind)),
    ...kinds.flatMap((kind) => pointTraces(study, cells, kind)),
    ...(cells.includes(study.chosen) ? [chosenTrace(study, kinds)] : []),
  ];
  const narrow = host.clientWidth < 600;
  const shared = sharedLayout(narrow);
  return draw(plotly, host, traces, {
    ...shared,
    xaxis: { ...axisStyle(), title: { text: "SOPs per sample", standoff: 8 }, rangemode: "tozero" },
    yaxis: { ...axisStyle(), ...within(100), title: { text: "test accuracy (%)" } },
    legend: { ...shared.legend, title: { text: "t<sub>ref</sub> RA-I & SA-I (ms) ", side: "top" } },
    uirevision: study.setting,
  });
}
