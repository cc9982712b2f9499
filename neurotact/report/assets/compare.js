// Comparison of two networks: accuracy, costs, and the difference.

function compareTable(front, one, other) {
  const a = front.networks[one], b = front.networks[other];
  const rows = Object.entries(KINDS).flatMap(([kind, { words }]) => [
    ["test accuracy", "accuracy", percent, (x, y) => `${(100 * (y - x)).toFixed(1)} points`],
    ["SOPs", "sops", count, relative], ["ms to decision", "ms", short, relative],
    ["input spikes", "spikes", short, relative], ["energy estimate (nJ)", "nJ", short, relative],
  ].filter(([, key]) => a[kind]?.[key] != null && b[kind]?.[key] != null).map(([name, key, write, change]) => [
    `${name}, ${words}`, write(a[kind][key]), write(b[kind][key]), change(a[kind][key], b[kind][key]),
  ]));
  const head = ["", `A: ${a.name}`, `B: ${b.name}`, "from A to B"];
  return element("table", {},
    element("thead", {}, element("tr", {}, ...head.map((text, i) => (i ? element("th", { scope: "col", class: "number" }, text) : element("td", {}))))),
    element("tbody", {}, ...rows.map(([name, ...values]) => element("tr", {}, element("th", { scope: "row" }, name),
      ...values.map((text) => element("td", { class: "number" }, text))))));
}

function relative(before, after) {
  if (!before) return "-";
  const change = 100 * (after / before - 1);
  return `${change > 0 ? "+" : ""}${change.toFixed(0)} %`;
}
