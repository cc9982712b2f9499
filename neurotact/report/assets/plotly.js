// The drawing library, and the common parts of the drawings of this page.

const SYMBOLS = ["circle", "square", "triangle-up", "diamond", "triangle-down", "cross"];

/* The symbol of a series: with a dot in it where there are more series than symbols. */
function symbolOf(index, isOpen) {
  return SYMBOLS[index % SYMBOLS.length] + (isOpen ? "-open" : "") + (index < SYMBOLS.length ? "" : "-dot");
}

/* The library is inside the page, gzipped; it is unpacked here, without network access. */
async function unpackPlotly() {
  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  document.head.append(element("script", {}, await new Response(stream).text()));
  return window.Plotly;
}

/* Escape plotly's markup. */
function plain(text) {
  return String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

function axisStyle() {
  return { gridcolor: style("--line"), zerolinecolor: style("--line"), linecolor: style("--soft"), automargin: true };
}

/* An axis of accuracies: limited to 0 and the maximum at any zoom. */
function within(whole) {
  return { minallowed: 0, maxallowed: whole };
}

/* The common layout of drawings; `narrow` on a phone. */
function sharedLayout(narrow) {
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: style("--ink"), size: narrow ? 11 : 13 },
    height: narrow ? 540 : 520, margin: { l: 50, r: 12, t: 34, b: 50 }, hovermode: "closest",
    hoverlabel: { bgcolor: style("--card"), bordercolor: style("--soft"), font: { color: style("--ink") }, align: "left" },
    dragmode: window.matchMedia("(pointer: coarse)").matches ? false : "zoom",
    legend: {
      orientation: "h", x: 0, y: narrow ? -0.24 : -0.2, yanchor: "top", traceorder: "normal",
      ...(narrow ? { entrywidth: 0.5, entrywidthmode: "fraction" } : {}),
    },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: style("--soft"), activecolor: style("--ink") },
  };
}

function draw(plotly, host, traces, layout) {
  return plotly.react(host, traces, layout, {
    responsive: true, displaylogo: false,
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
    toImageButtonOptions: { format: "svg", filename: "trade-off" },
  });
}
