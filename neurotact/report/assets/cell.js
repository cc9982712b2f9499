// One cell's network: one test window, costs, confusions, training.

const MOST_LETTERS = 14;

function showCell(cell, study) {
  document.getElementById("cell-name").textContent = cell.name;
  const row = cell.row;
  const early = row.exit_accuracy == null ? "" :
    ` With early exit: ${percent(row.exit_accuracy)} for ${count(row.exit_sops_total)} SOPs, ` +
    `after ${inTime(row.exit_steps, study)} of ${inTime(row.window_steps, study)} on average.`;
  document.getElementById("cell-words").textContent =
    `Test accuracy ${percent(row.accuracy_test)} for ${count(row.sops_total)} SOPs per window.${early}`;
  fill("cell-raster", "One test window", cell.raster, (width) => raster(cell.raster, study, width),
    "The network is not in the folder of this run.");
  fill("cell-sops", "Synaptic operations per window", row, () => ledger(cell, study));
  fill("cell-confusion", "Confusion matrix", cell.confusion, () => confusion(cell.confusion, study));
  fill("cell-training", "Training", cell.training, (width) => training(cell.training, width));
  if (document.getElementById("cell-search")) fill("cell-search", "Its search", cell.search, (width) => search(cell.search, width));
}

/* Steps of the encoder's clock in ms, if the clock is known. */
function inTime(steps, study) {
  return study.stepMs ? `${count(steps * study.stepMs)} ms` : `${count(steps)} steps`;
}

function fill(id, title, data, draw, otherwise = "Not in the folder of this run.") {
  const host = document.getElementById(id);
  host.replaceChildren(element("h5", {}, title));
  host.append(...(data ? draw(Math.max(240, host.clientWidth)) : [element("p", { class: "soft" }, otherwise)]));
}

function raster(window, study, width) {
  const longest = Math.max(6, ...study.classes.map((name) => Math.min(name.length, MOST_LETTERS)));
  const left = 26 + 6.3 * longest, right = 14, plot = width - left - right;
  const slow = window.input.filter((_, i) => window.isSA[i]);
  const quick = window.input.filter((_, i) => !window.isSA[i]);
  const [first, second] = study.populations;
  const layers = [[first, slow, "--sa", 90], [second, quick, "--ra", 90], ["hidden", window.hidden, "--ink", 150]];
  const height_of = (rows, room) => Math.min(9, Math.max(1.5, room / rows));
  const x = (step) => left + (plot * (step + 0.5)) / window.shown;
  const drawn = [];
  let y = 14;
  for (const [name, rows, colour, room] of layers) {
    if (!rows.length) continue;
    const height = height_of(rows.length, room);
    drawn.push(band(left, y, plot, rows.length * height), label(name, left - 8, y + (rows.length * height) / 2), strokes(rows, x, y, height, `var(${colour})`));
    y += rows.length * height + 10;
  }
  drawn.push(band(left, y, plot, 13 * window.readout.length));
  window.readout.forEach((steps, index) => {
    const colour = index === window.true ? "var(--yes)" : "var(--no)";
    const name = `${cropped(study.classes[index])}${index === window.true ? " ✓" : ""}`;
    const words = label(name, left - 8, y + 5.5);
    if (index === window.taken) words.setAttribute("font-weight", "700");
    drawn.push(words, strokes([steps], x, y + 1, 11, colour));
    y += 13;
  });
  const bottom = y + 2;
  const end = window.shown * window.step_ms;
  for (const at of ticks(0, end, plot / 70)) {
    const place = left + (plot * at) / end;
    drawn.push(mark("path", { d: `M${place} ${bottom}v4`, stroke: "var(--soft)" }),
      mark("text", { x: place, y: bottom + 16, "text-anchor": "middle", class: "tick" }, short(at)));
  }
  drawn.push(mark("path", { d: `M${left} ${bottom}h${plot}`, stroke: "var(--soft)" }),
    mark("text", { x: left + plot / 2, y: bottom + 32, "text-anchor": "middle", class: "tick" }, "time in the window (ms)"));
  const exits = window.exitStep < window.steps;
  if (exits && window.exitStep <= window.shown) {
    const at = left + (plot * window.exitStep) / window.shown;
    drawn.push(mark("path", { d: `M${at} 8V${bottom}`, stroke: "var(--ink)", "stroke-dasharray": "4 3" }));
  }
  const sum = (rows) => rows.reduce((total, steps) => total + steps.length, 0);
  const name = (index) => `${study.classWord} ${study.classes[index]}`;
  const early = exits ? `Early exit (dashed line) after ${count(window.exitStep * window.step_ms)} ms, for ${name(window.exitTaken)}.`
    : "Early exit does not stop before the end of the window.";
  const cut = window.shown < window.steps ? ` Its first ${count(end)} ms are drawn.` : "";
  const words = `Trial ${window.trial}, from ${short(window.start_ms)} ms on: ${name(window.true)} (✓), classified as ` +
    `${name(window.taken)} (bold). ${count(sum(window.input))} input, ${count(sum(window.hidden))} hidden and ` +
    `${count(sum(window.readout))} readout spikes. ${early}${cut}`;
  const svg = picture(width, bottom + 38, words);
  svg.append(...drawn);
  return [svg, element("p", { class: "soft" }, words)];
}

function cropped(name) {
  return name.length > MOST_LETTERS ? `${name.slice(0, MOST_LETTERS - 1)}…` : name;
}

function band(x, y, width, height) {
  return mark("rect", { x, y: y - 1, width, height: height + 2, fill: "var(--ground)" });
}

function label(text, x, y) {
  return mark("text", { x, y, "text-anchor": "end", "dominant-baseline": "central", class: "tick" }, text);
}

function strokes(rows, x, top, height, colour) {
  const tall = Math.max(1.2, height - 0.8);
  const d = rows.map((steps, i) => {
    const y = (top + i * height).toFixed(1);
    return steps.map((step) => `M${x(step).toFixed(1)} ${y}v${tall.toFixed(1)}`).join("");
  }).join("");
  return mark("path", { d, stroke: colour, "stroke-width": 1.3, fill: "none" });
}

function ledger(cell, study) {
  const row = cell.row;
  const line = (name, full, exit, write) => {
    const saved = full > 0 && exit != null ? percent(1 - exit / full) : "-";
    const values = write === percent ? [write(full), write(exit), ""] : [write(full), write(exit), saved];
    return element("tr", {}, element("th", { scope: "row" }, name),
      ...values.map((text) => element("td", { class: "number" }, text)));
  };
  const sops = (what) => [row[`sops_${what}`], row[`exit_sops_${what}`]];
  const table = element("table", {},
    element("thead", {}, element("tr", {}, ...["", "full window", "early exit", "saved"].map(
      (head, i) => (i ? element("th", { scope: "col", class: "number" }, head) : element("td", {}))))),
    element("tbody", {},
      line("afferents to hidden", ...sops("input"), count),
      line("among hidden", ...sops("recurrent"), count),
      line("hidden to readout", ...sops("readout"), count),
      line("total", ...sops("total"), count),
      line("total, not recurrent", ...sops("total_feedforward"), count),
      line(study.stepMs ? "ms to decision" : "steps", row.window_steps * (study.stepMs || 1), row.exit_steps * (study.stepMs || 1), count),
      line("test accuracy", row.accuracy_test, row.exit_accuracy, percent)));
  const own = Object.keys(row).filter((key) => /^spikes_[a-z0-9_]+$/.test(key) && !key.endsWith("_s") && row[key] !== null);
  const named = (key) => ({ sa: "SA-I", ra: "RA-I" }[key.slice(7)] || key.slice(7).toUpperCase());
  const sent = `${own.map((key) => `${count(row[key], 1)} ${named(key)}`).join(" and ")} input spikes.`;
  return [element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Synaptic operations" }, table),
    element("p", { class: "soft" }, `Means over test windows. ${sent}`)];
}

function confusion(matrix, study) {
  const head = element("tr", {}, element("td", {}, "true ↓ taken →"),
    ...study.classes.map((name) => element("th", { scope: "col", class: "number" }, name)));
  const rows = matrix.map((counts, index) => {
    const all = counts.reduce((a, b) => a + b, 0);
    const cells = counts.map((n, taken) => {
      const cell = element("td", { class: "number" }, n ? String(n) : "");
      const colour = taken === index ? "var(--sa)" : "var(--ra)";
      if (n) cell.style.background = `color-mix(in srgb, ${colour} ${Math.round((45 * n) / all)}%, transparent)`;
      return cell;
    });
    return element("tr", {}, element("th", { scope: "row" }, study.classes[index]), ...cells);
  });
  const table = element("table", { class: "confusion" }, element("thead", {}, head), element("tbody", {}, ...rows));
  return [element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "True and predicted classes" }, table),
    element("p", { class: "soft" }, `Test windows by true ${study.classWord} (rows) and predicted one (columns).`)];
}

function training(log, width) {
  const each = width < 520 ? width : width / 2;
  const charts = [["loss", 1, "loss"], ["accuracy", 100, "accuracy (%)"]].map(([what, scale, words]) =>
    chart(log.epoch, log[`train_${what}`], log[`validation_${what}`], scale, words, log.kept, Math.floor(each) - 6));
  const whose = log.members ? ` Of the first of ${log.members} networks that were joined.` : "";
  const note = log.kept == null ? "" : `${whose} The network has the weights of epoch ${log.kept} (dotted line).${log.note ? ` ${log.note}` : ""}`;
  return [element("div", { class: "charts" }, ...charts),
    element("p", { class: "soft" }, `Solid: validation. Dashed: training.${note}`)];
}

function chart(epochs, train, validation, scale, words, kept, width) {
  const left = 44, right = 16, top = 20, height = 170, bottom = height - 34;
  const values = [...(train || []), ...(validation || [])].filter((v) => v != null).map((v) => v * scale);
  const high = Math.max(...values), low = Math.min(...values, 0.9 * high);
  const x = (epoch) => left + ((width - left - right) * (epoch - epochs[0])) / Math.max(1, epochs.at(-1) - epochs[0]);
  const y = (value) => bottom - ((bottom - top) * (value - low)) / (high - low || 1);
  const svg = picture(width, height, `${words} over ${epochs.length} epochs`);
  for (const at of ticks(low, high, 4)) {
    svg.append(mark("path", { d: `M${left} ${y(at)}H${width - right}`, stroke: "var(--line)" }), label(short(at), left - 5, y(at)));
  }
  for (const at of ticks(epochs[0], epochs.at(-1), 5).filter(Number.isInteger)) {
    svg.append(mark("text", { x: x(at), y: bottom + 14, "text-anchor": "middle", class: "tick" }, String(at)));
  }
  svg.append(mark("text", { x: left, y: 12, class: "tick" }, words),
    mark("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle", class: "tick" }, "epoch"));
  const line = (series, colour, dashes) => {
    const points = (series || []).map((v, i) => (v == null ? "" : `${x(epochs[i]).toFixed(1)},${y(v * scale).toFixed(1)}`));
    svg.append(mark("polyline", { points: points.join(" "), fill: "none", stroke: colour, "stroke-width": 1.6, "stroke-dasharray": dashes }));
  };
  line(train, "var(--sa)", "5 3");
  line(validation, "var(--ra)", "none");
  if (kept != null) svg.append(mark("path", { d: `M${x(kept)} ${top}V${bottom}`, stroke: "var(--ink)", "stroke-dasharray": "1 3" }));
  return svg;
}

/* Values of the trials: filled if finished, open if stopped; a line for the best so far. */
function search(found, width) {
  const left = 44, right = 16, top = 20, height = 190, bottom = height - 34;
  const known = found.values.filter((value) => value != null);
  const high = Math.max(...known), low = Math.min(...known);
  const x = (trial) => left + ((width - left - right) * (trial + 0.5)) / found.values.length;
  const y = (value) => bottom - ((bottom - top) * (value - low)) / (high - low || 1);
  const counts = ["finished", "stopped", "failed"].map((outcome) => found.outcomes.filter((other) => other === outcome).length);
  const words = `${found.values.length} trials: ${counts[0]} finished (filled), ${counts[1]} stopped early (open), ${counts[2]} failed. ` +
    `The best is trial ${found.best} with ${short(found.values[found.best])}: ` +
    `${Object.entries(found.chosen).map(([key, value]) => `${key} ${value}`).join(", ")}.`;
  const svg = picture(width, height, words);
  for (const at of ticks(low, high, 4)) {
    svg.append(mark("path", { d: `M${left} ${y(at)}H${width - right}`, stroke: "var(--line)" }), label(short(at), left - 5, y(at)));
  }
  for (const at of ticks(0, found.values.length - 1, 8).filter(Number.isInteger)) {
    svg.append(mark("text", { x: x(at), y: bottom + 14, "text-anchor": "middle", class: "tick" }, String(at)));
  }
  svg.append(mark("text", { x: left, y: 12, class: "tick" }, "value"),
    mark("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle", class: "tick" }, "trial"));
  let best = -Infinity, line = "";
  found.values.forEach((value, trial) => {
    if (value == null) return;
    const finished = found.outcomes[trial] === "finished";
    if (finished && value > best) {
      best = value;
      line += line ? `H${x(trial).toFixed(1)}V${y(best).toFixed(1)}` : `M${x(trial).toFixed(1)} ${y(best).toFixed(1)}`;
    }
    svg.append(mark("circle", { cx: x(trial), cy: y(value), r: 3, stroke: "var(--sa)", fill: finished ? "var(--sa)" : "none" }));
  });
  svg.append(mark("path", { d: `${line}H${width - right}`, stroke: "var(--ink)", "stroke-width": 1.3, fill: "none" }));
  return [svg, element("p", { class: "soft" }, words)];
}
