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
      entrywidth: 0.5, entrywidthmode: "fraction",
    },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: style("--soft"), activecolor: style("--ink") },
  };
}

/* A text in lines of at most so many characters, as far as its words are shorter. */
function wrapped(text, most) {
  return text.replace(new RegExp(`(?=.{${most + 1}})(.{1,${most}}) `, "g"), "$1<br>");
}

/* The lines that leave the points at least a third of the axis: the table names the others. */
function near(lines, heights) {
  const least = Math.min(...heights), room = 2 * Math.max(10, Math.max(...heights) - least);
  return lines.filter((line) => line.y >= least - room);
}

/* The places of marks, whiskers and fronts in pixels of the plot, as small circles: x, y, radius. */
function inkOf(host) {
  const { xaxis, yaxis } = host._fullLayout, found = [];
  const along = ([x0, y0], [x1, y1]) => {
    const steps = Math.ceil(Math.hypot(x1 - x0, y1 - y0) / 4) || 1;
    for (let i = 0; i <= steps; i++) found.push([x0 + ((x1 - x0) * i) / steps, y0 + ((y1 - y0) * i) / steps, 2]);
  };
  for (const { mode, x, y, marker, error_y: bar } of host._fullData) {
    const at = [...x].map((value, i) => [xaxis.d2p(value), yaxis.d2p(y[i]), i]).filter(([left, top]) => Number.isFinite(left + top));
    for (const [left, top, i] of at) {
      if (mode === "markers") found.push([left, top, 1 + ([marker.size].flat()[i] ?? marker.size) / 2]);
      if (bar?.array) along([left, yaxis.d2p(y[i] + bar.array[i])], [left, yaxis.d2p(y[i] - bar.arrayminus[i])]);
    }
    if (mode === "lines") at.slice(1).forEach(([left, top], i) => { along(at[i], [left, at[i][1]]); along([left, at[i][1]], [left, top]); });
  }
  return found;
}

/* Names of level lines where nothing else is drawn: above or below the line, in few rows, as far left as there is room. */
function namesOf(host, lines) {
  const { xaxis, yaxis, font } = host._fullLayout, ink = inkOf(host), pen = document.createElement("canvas").getContext("2d");
  pen.font = `11px ${font.family}`;
  return lines.map((line) => {
    const at = yaxis.d2p(line.y);
    let best = { hidden: Infinity };
    for (const most of [60, 32, 22]) {
      const rows = wrapped(line.words, most).split("<br>"), high = 14 * rows.length + 2;
      const wide = Math.max(...rows.map((row) => pen.measureText(row).width)) + 4;
      for (let left = 4; left + wide <= xaxis._length || left === 4; left += 6) {
        for (const top of [at - high, at]) {
          const isOut = top < 0 || top + high > yaxis._length || left + wide > xaxis._length;
          const over = ink.filter(([x, y, r]) => x > left - r && x < left + wide + r && y > top - r && y < top + high + r).length;
          if (over + 1e6 * isOut < best.hidden) best = { hidden: over + 1e6 * isOut, left, top, wide, high, text: rows.join("<br>") };
        }
      }
    }
    for (let x = best.left; x < best.left + best.wide; x += 4) ink.push([x, best.top + best.high / 2, best.high / 2]);
    return {
      xref: "paper", x: best.left / xaxis._length, xanchor: "left", y: line.y, yref: "y", yanchor: best.top < at ? "bottom" : "top", borderpad: 1,
      text: best.text, align: "left", showarrow: false, font: { color: line.colour, size: 11 }, bgcolor: best.hidden ? style("--ground") : "rgba(0,0,0,0)",
    };
  });
}

/* Draw traces, and level lines (y, words, colour, dash) with their names; a long name in the legend is wrapped. */
function draw(plotly, host, traces, layout, lines = []) {
  const shapes = lines.map((line) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: line.y, y1: line.y, line: { color: line.colour, width: 1.3, dash: line.dash } }));
  const named = traces.map((trace) => ({ ...trace, name: wrapped(trace.name, host.clientWidth < 600 ? 18 : 32) }));
  const entries = traces.filter((trace) => trace.showlegend !== false).length, height = layout.height + 12 * Math.max(0, entries - 8);
  host.style.height = `${height}px`;  // which plotly takes where the window changes
  return plotly.react(host, named, { ...layout, shapes, height }, {
    responsive: true, displaylogo: false,
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
    toImageButtonOptions: { format: "svg", filename: "trade-off" },
  }).then(() => {
    const name = () => plotly.relayout(host, { annotations: namesOf(host, lines) });
    host.removeAllListeners("plotly_relayout");
    host.on("plotly_relayout", (change) => { if (!change.annotations) name(); });  // zoomed, or of another width
    return name();
  });
}
