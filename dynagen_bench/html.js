// What every page does: it says that scripts run, and opens the part that something leads to, and on paper all of them.
"use strict";
const all = (selector, root = document) => [...root.querySelectorAll(selector)];
document.body.classList.add("js");

function open() {
  const part = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (part && part.tagName === "DETAILS") { part.hidden = false; part.open = true; part.scrollIntoView(); }
}
addEventListener("hashchange", open);
addEventListener("beforeprint", () => { for (const part of all("details")) part.open = true; });
