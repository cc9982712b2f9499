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

/* The lines that leave the points at least a third of the axis, or of another `share`: the table names the others. */
function near(lines, heights, share = 2) {
  const least = Math.min(...heights), room = share * Math.max(10, Math.max(...heights) - least);
  return lines.filter((line) => line.y >= least - room);
}

/* A line in pixels as small circles: x, y, radius. */
function along([x0, y0], [x1, y1]) {
  const steps = Math.ceil(Math.hypot(x1 - x0, y1 - y0) / 4) || 1;
  return Array.from({ length: steps + 1 }, (_, i) => [x0 + ((x1 - x0) * i) / steps, y0 + ((y1 - y0) * i) / steps, 2]);
}

/* The places of marks, whiskers and fronts in pixels of the plot, as such circles. */
function inkOf(host) {
  const { xaxis, yaxis } = host._fullLayout, found = [];
  for (const { mode, x, y, marker, line, error_y: bar } of host._fullData) {
    const at = [...x].map((value, i) => [xaxis.d2p(value), yaxis.d2p(y[i]), i]).filter(([left, top]) => Number.isFinite(left + top));
    for (const [left, top, i] of at) {
      if (mode === "markers") found.push([left, top, 1 + ([marker.size].flat()[i] ?? marker.size) / 2]);
      if (bar?.array) found.push(...along([left, yaxis.d2p(y[i] + bar.array[i])], [left, yaxis.d2p(y[i] - bar.arrayminus[i])]));
    }
    if (mode === "lines") at.slice(1).forEach(([left, top], i) => {
      const corner = line.shape === "hv" ? [left, at[i][1]] : at[i];
      found.push(...along(at[i], corner), ...along(corner, [left, top]));
    });
  }
  return found;
}

/* The size of a text in lines of at most so many characters, and these lines; `pen`: a canvas of its font. */
function sized(pen, words, most) {
  const rows = wrapped(words, most).split("<br>");
  return { text: rows.join("<br>"), wide: Math.max(...rows.map((row) => pen.measureText(row).width)) + 4, high: 14 * rows.length + 2 };
}

/* Of several boxes the one of the least cost: what it covers of `ink`, what its line crosses, and how far it is. */
function freest(host, ink, boxes) {
  const { xaxis, yaxis, _size: margin } = host._fullLayout;
  let best = { hidden: true, cost: Infinity };
  for (const box of boxes) {
    const { left, top, wide, high, far = 0, line = [] } = box;
    if (far >= best.cost) break;
    const isOut = left < 0 || top < 32 - margin.t || left + wide > xaxis._length || top + high > yaxis._length;
    const over = ink.filter(([x, y, r]) => x > left - r && x < left + wide + r && y > top - r && y < top + high + r).length;
    const crossed = over || isOut ? 0 : line.filter(([x, y]) => ink.some(([at, up, r]) => Math.hypot(x - at, y - up) < r + 1)).length;
    const cost = 1e6 * isOut + 1e3 * over + 12 * crossed + far;
    if (cost < best.cost) best = { ...box, cost, hidden: isOut || over > 0 };
  }
  return best;
}

/* What covers a box, as circles. */
function covering({ left, top, wide, high }) {
  return [4, 8, 12].map((down) => top + down * high / 16).flatMap((y) => along([left, y], [left + wide, y]).map(([x]) => [x, y, high / 4]));
}

/* The places for the name of a point, beside it and, with a line to the point, further away; the line begins beside the mark. */
function placesAround(at, up, words, pen) {
  const sizes = [40, 24, 14].map((most) => sized(pen, words, most)), angles = [0, 12, 18, 6, ...Array.from({ length: 24 }, (_, i) => i)].map((i) => (i * Math.PI) / 12);
  return [10, 17, 28, 42, 60, 82, 108, 138].flatMap((far) => sizes.flatMap((size) => angles.map((angle) => {
    const [right, down] = [Math.cos(angle), Math.sin(angle)], aside = (share) => (Math.abs(share) > 0.3 ? Math.sign(share) / 2 : 0);
    const [ax, ay] = [right * far + aside(right) * size.wide, down * far + aside(down) * size.high];
    const line = far > 17 ? along([at + 9 * right, up + 9 * down], [at + right * far, up + down * far]) : [];
    return { ...size, far, ax, ay, line, left: at + ax - size.wide / 2, top: up + ay - size.high / 2 };
  })));
}

/* Names of points where nothing else is drawn, `hidden` where there is no room: of several orders to place them the best. */
function namesOfPoints(host, points, ink, pen) {
  const { xaxis, yaxis } = host._fullLayout;
  const placed = points.map((point) => ({ ...point, at: xaxis.d2p(point.x), up: yaxis.d2p(point.y) }))
    .filter(({ at, up }) => at >= 0 && at <= xaxis._length && up >= 0 && up <= yaxis._length);
  const orders = [(a, b) => a.at - b.at, (a, b) => b.at - a.at, (a, b) => a.up - b.up, (a, b) => b.up - a.up];
  const tries = orders.map((order) => {
    const covered = [...ink];
    return [...placed].sort(order).map(({ x, y, words, at, up }) => {
      const best = freest(host, covered, placesAround(at, up, plain(words), pen));
      if (!best.hidden) covered.push(...covering(best), ...best.line);
      return { x, y, ...best };
    });
  });
  const cost = (names) => names.reduce((sum, name) => sum + name.cost, 0);
  return tries.sort((a, b) => cost(a) - cost(b))[0];
}

/* The annotations of points: their names, or, where one has no room, their numbers in the list below the plot, which has all names. */
function atPoints(host, points, ink, pen) {
  const { xaxis } = host._fullLayout, ordered = [...points].sort((a, b) => a.x - b.x || b.y - a.y);
  const names = namesOfPoints(host, points, ink, pen), isFull = names.some((name) => name.hidden);
  const numbers = ordered.map((point, i) => ({ ...point, words: String(i + 1) }));
  if (!host.list) host.after(host.list = element("ol", { class: "numbered", "aria-label": "names of the numbered points" }));
  host.list.hidden = !isFull;
  host.list.replaceChildren(...(isFull ? ordered.map(({ words }) => element("li", {}, words)) : []));
  return (isFull ? namesOfPoints(host, numbers, ink, pen) : names).map(({ x, y, text, ax, ay, line }) => ({
    x: xaxis.type === "log" ? Math.log10(x) : x, y, text, font: { color: style("--ink"), size: 11 }, borderpad: 1,
    xanchor: "center", yanchor: "middle", showarrow: line.length > 0, arrowhead: 0, arrowwidth: 0.8, arrowcolor: style("--soft"), standoff: 7,
    ...(line.length ? { ax, ay } : { xshift: ax, yshift: -ay }),
  }));
}

/* Names of level lines where nothing else is drawn: above or below the line, in few rows, as far left as there is room;
   where there is none, further away, with a thin line to it. */
function namesOf(host, lines, ink, pen) {
  const { xaxis, yaxis } = host._fullLayout;
  return lines.map((line) => {
    const at = yaxis.d2p(line.y);
    const boxes = [0, 12, 24, 38, 54, 72, 92, 114, 140].flatMap((far) => [60, 32, 22].flatMap((most) => {
      const size = sized(pen, line.words, most), lefts = [4];
      while (lefts.at(-1) + 6 + size.wide <= xaxis._length) lefts.push(lefts.at(-1) + 6);
      return lefts.flatMap((left) => [-1, 1].map((down) => {
        const middle = left + size.wide / 2, top = down < 0 ? at - size.high - far : at + far;
        return { ...size, far, left, top, ay: down * (far + size.high / 2), line: far ? along([middle, at], [middle, at + down * far]) : [] };
      }));
    }));
    const best = freest(host, ink, boxes);
    ink.push(...covering(best), ...best.line);
    if (best.far) return {
      xref: "paper", x: (best.left + best.wide / 2) / xaxis._length, xanchor: "center", y: line.y, yref: "y", yanchor: "middle", ax: 0, ay: best.ay,
      text: best.text, arrowhead: 0, arrowwidth: 0.8, arrowcolor: line.colour, font: { color: line.colour, size: 11 }, borderpad: 1,
    };
    return {
      xref: "paper", x: best.left / xaxis._length, xanchor: "left", y: line.y, yref: "y", yanchor: best.top < at ? "bottom" : "top", borderpad: 1,
      text: best.text, align: "left", showarrow: false, font: { color: line.colour, size: 11 }, bgcolor: best.hidden ? style("--ground") : "rgba(0,0,0,0)",
    };
  });
}

/* Draw traces, level lines (y, words, colour, dash) and names of points (x, y, words); a long name in the legend is wrapped. */
function draw(plotly, host, traces, layout, lines = [], points = []) {
  const shapes = lines.map((line) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: line.y, y1: line.y, line: { color: line.colour, width: 1.3, dash: line.dash } }));
  const named = traces.map((trace) => ({ ...trace, name: wrapped(trace.name, host.clientWidth < 600 ? 18 : 32) }));
  const entries = traces.filter((trace) => trace.showlegend !== false).length, height = layout.height + 12 * Math.max(0, entries - 8);
  host.style.height = `${height}px`;  // which plotly takes where the window changes
  return plotly.react(host, named, { ...layout, shapes, height }, {
    responsive: true, displaylogo: false,
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
    toImageButtonOptions: { format: "svg", filename: "trade-off" },
  }).then(() => {
    const name = () => {
      const ink = inkOf(host), pen = document.createElement("canvas").getContext("2d");
      const { xaxis, yaxis, font } = host._fullLayout;
      pen.font = `11px ${font.family}`;
      const named = namesOf(host, lines, ink, pen);
      for (const { y } of lines) ink.push(...along([0, yaxis.d2p(y)], [xaxis._length, yaxis.d2p(y)]));
      return plotly.relayout(host, { annotations: [...named, ...atPoints(host, points, ink, pen)] });
    };
    host.removeAllListeners("plotly_relayout");
    host.on("plotly_relayout", (change) => { if (!change.annotations) name(); });  // zoomed, or of another width
    return name();
  });
}
