// The table of networks: column heads sort it, arrow keys move between rows, Enter or a click selects one.

function sortable(table, status) {
  for (const [column, head] of [...table.tHead.rows[0].cells].entries()) {
    const button = element("button", { type: "button" }, head.textContent);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      sort(table.tBodies[0], column, down ? -1 : 1);
      status.textContent = `Sorted by ${button.textContent}, ${down ? "descending" : "ascending"}.`;
    });
    head.replaceChildren(button);
  }
}

/* Stable; missing values come last in both directions. */
function sort(body, column, sign) {
  const value = (row) => row.cells[column].dataset.value;
  const rows = [...body.rows].sort((a, b) => {
    const [one, two] = [value(a), value(b)];
    if (one === "" || two === "") return (one === "") - (two === "");
    const difference = Number(one) - Number(two);
    return sign * (Number.isNaN(difference) ? one.localeCompare(two, "en", { numeric: true }) : difference);
  });
  body.append(...rows);
}

function walkable(body, choose) {
  const reach = (row) => {
    for (const other of body.rows) other.tabIndex = other === row ? 0 : -1;
  };
  reach(body.rows[0]);
  body.addEventListener("focusin", (event) => reach(event.target.closest("tr")));
  body.addEventListener("click", (event) => choose(Number(event.target.closest("tr").dataset.cell), event));
  body.addEventListener("keydown", (event) => {
    const row = event.target.closest("tr");
    const next = {
      ArrowDown: row.nextElementSibling, ArrowUp: row.previousElementSibling,
      Home: body.rows[0], End: body.rows[body.rows.length - 1],
    }[event.key];
    if (next) next.focus();
    else if (event.key === "Enter" || event.key === " ") choose(Number(row.dataset.cell), event);
    else return;
    event.preventDefault();
  });
  return reach;
}
