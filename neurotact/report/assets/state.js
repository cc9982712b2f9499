// What is chosen on the page stands in its address after #, so that the address can be kept and shared.

/* The choices in the address; nothing where it names a section. */
function stateOfAddress() {
  const text = window.location.hash.slice(1);
  return new URLSearchParams(text.includes("=") ? text : "");
}

/* Write choices into the address, those that are not as they begin; the history gains no entry. */
function keepInAddress(chosen, beginning) {
  const changed = Object.entries(chosen).filter(([key, value]) => String(value) !== String(beginning[key]));
  const text = new URLSearchParams(changed).toString();
  if (text || window.location.hash.includes("=")) window.history.replaceState(null, "", text ? `#${text}` : "#");
}

/* A link to a section opens what is folded in it. */
function unfoldOnVisit() {
  for (const link of document.querySelectorAll('a[href^="#"]')) {
    link.addEventListener("click", () => {
      const target = document.getElementById(link.getAttribute("href").slice(1));
      for (const folded of target?.querySelectorAll(":scope > details") ?? []) folded.open = true;
    });
  }
}
