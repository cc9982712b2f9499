// The choices on the page are in its address after #, so that the address can be kept and shared.

/* The choices in the address; empty if it names a section. */
function stateOfAddress() {
  const text = window.location.hash.slice(1);
  return new URLSearchParams(text.includes("=") ? text : "");
}

/* Write choices other than the defaults into the address, and those that it holds; the history gets no entry. */
function keepInAddress(chosen, beginning) {
  const held = stateOfAddress();
  const changed = Object.entries(chosen).filter(([key, value]) => String(value) !== String(beginning[key]) || (value && held.has(key)));
  const text = new URLSearchParams(changed).toString();
  if (text || window.location.hash.includes("=")) window.history.replaceState(null, "", text ? `#${text}` : "#");
}

/* A link to a section opens the folded parts in it. */
function unfoldOnVisit() {
  for (const link of document.querySelectorAll('a[href^="#"]')) {
    link.addEventListener("click", () => {
      const target = document.getElementById(link.getAttribute("href").slice(1));
      for (const folded of target?.querySelectorAll(":scope > details") ?? []) folded.open = true;
    });
  }
}
