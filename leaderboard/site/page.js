// Sorting, filtering and pointing. Without it the page shows everything, as means, in the order of the board.
const main = document.querySelector("main"), ALL = "All robots";
const chosen = id => { const input = document.getElementById(id); return input ? input.value : ""; };

// What is shown: tables of the track, columns and charts of the robot, entries by label and text.
function filter() {
  const robot = chosen("robot"), label = chosen("label"), find = chosen("find").trim().toLowerCase();
  main.dataset.measure = chosen("measure") || "mean";
  const visible = new Set();
  for (const section of all(".track")) {
    section.hidden = chosen("track") !== "" && chosen("track") !== section.id;
    for (const row of all("tbody tr", section.querySelector(".sortable"))) {
      const cell = robot && all("td[data-column]", row).find(one => one.dataset.column === robot);
      const has = !robot || (cell && cell.dataset.mean !== undefined);
      row.hidden = !has || (label && row.dataset.label !== label) || !row.dataset.find.toLowerCase().includes(find);
      if (!row.hidden && !section.hidden) visible.add(row.dataset.slug);
    }
  }
  for (const part of all("[data-column]")) part.hidden = robot !== "" && part.dataset.column !== robot;
  for (const part of all("[data-rank]")) part.hidden = part.dataset.rank !== (robot || ALL);
  for (const part of all(".panels")) part.classList.toggle("one", robot !== "");
  for (const part of all(".charts [data-slug], details[data-slug]")) part.hidden = !visible.has(part.dataset.slug);
  for (const chart of all(".improvement")) compare(chart, visible);
  const total = all(".sortable tbody tr").length, count = document.querySelector(".count");
  if (count) count.textContent = visible.size === total ? `${total} ${total === 1 ? "entry" : "entries"}` : visible.size ? `${visible.size} of ${total} entries` : "No entry is like that.";
}

// A column's value in a row, a number or a text; null sorts last.
function value(row, head) {
  if (head.dataset.key === "figure") {
    const given = all("td[data-column]", row).find(one => one.dataset.column === head.dataset.column).dataset[main.dataset.measure];
    return given === undefined ? null : Number(given);
  }
  if (head.dataset.key === "rank") {
    const given = row.querySelector("[data-rank]:not([hidden])")?.dataset.value;
    return given ? Number(given) : null;  // a table without the chosen robot has no rank to show
  }
  return row.cells[head.cellIndex].dataset.text.toLowerCase();
}

function sort(table, head, direction) {
  for (const other of all("th[aria-sort]", table)) other.removeAttribute("aria-sort");
  if (head) head.setAttribute("aria-sort", direction > 0 ? "ascending" : "descending");
  const rows = all("tbody tr", table), place = row => Number(row.dataset.place);
  rows.sort((a, b) => {
    if (!head) return place(a) - place(b);
    const x = value(a, head), y = value(b, head);
    if (x === null || y === null) return (x === null) - (y === null) || place(a) - place(b);
    return (x < y ? -direction : x > y ? direction : 0) || place(a) - place(b);
  });
  table.tBodies[0].append(...rows);
}

// Numbers from the best down, texts from A up.
const natural = head => head.dataset.key === "figure" && main.dataset.measure !== "gap" ? -1 : 1;

function sortByRobot() {
  for (const table of all(".sortable")) {
    const head = chosen("robot") && all("th[data-column]", table).find(one => one.dataset.column === chosen("robot"));
    sort(table, head || null, head ? natural(head) : 1);
  }
}

for (const table of all(".sortable")) {
  for (const button of all("thead button", table)) {
    button.addEventListener("click", () => {
      const head = button.parentNode, now = head.getAttribute("aria-sort");
      sort(table, head, now ? (now === "ascending" ? -1 : 1) : natural(head));
    });
  }
}

// The probability that each entry improves over the chosen one.
function compare(chart, visible) {
  const other = Number(chart.closest(".charts").querySelector(".over select").value), table = JSON.parse(chart.dataset.table);
  for (const row of all("li[data-slug]", chart)) {
    const found = table[Number(row.dataset.index)][other];
    row.hidden = !found || (visible ? !visible.has(row.dataset.slug) : row.hidden);
    if (!found) continue;
    const [per, low, high, robots] = found, sure = low >= 0, [span, dot] = [row.querySelector(".span"), row.querySelector(".dot")];
    span.toggleAttribute("hidden", !sure);
    for (const [line, x1, x2] of [[span, low, high], [dot, per, per]]) { line.setAttribute("x1", Math.max(x1, 0)); line.setAttribute("x2", Math.max(x2, 0)); }
    row.querySelector(".value").textContent = `${per} %${sure ? ` [${low}, ${high}]` : ""}`;
    row.title = `${row.querySelector("bdi").textContent}: ${row.querySelector(".value").textContent}, on ${robots} ${robots === 1 ? "robot" : "robots"}`;
  }
}

// The profiles' values at the slider's score.
function cut(charts, score) {
  charts.querySelector(".slider input").value = score;
  charts.querySelector(".slider output").textContent = score;
  const place = score / 2, percent = points => Math.round(100 - points.getItem(place).y);
  for (const panel of all(".profile", charts)) {
    for (const end of ["x1", "x2"]) panel.querySelector(".cursor").setAttribute(end, score);
    const lines = all("g[data-slug]", panel);
    for (const row of all(".key li", panel)) {
      const group = lines.find(one => one.dataset.slug === row.dataset.slug), band = group.querySelector(".band");
      const ends = band && [Math.round(100 - band.points.getItem(band.points.numberOfItems - 1 - place).y), percent(band.points)];
      row.querySelector(".value").textContent = `${percent(group.querySelector(".line").points)} %${ends ? ` [${ends.join(", ")}]` : ""}`;
    }
  }
}

for (const charts of all(".charts")) {
  const slider = charts.querySelector(".slider input");
  slider.addEventListener("input", () => cut(charts, Number(slider.value)));
  for (const drawing of all(".profile svg", charts)) {
    const point = event => {
      const box = drawing.getBoundingClientRect();
      cut(charts, 2 * Math.round(50 * Math.min(1, Math.max(0, (event.clientX - box.left) / box.width))));
    };
    for (const name of ["pointermove", "pointerdown"]) drawing.addEventListener(name, point);
  }
  const over = charts.querySelector(".over select");
  if (over) over.addEventListener("change", filter);
  // The entry that is pointed at stands out in every chart of its table.
  const heat = event => {
    const place = event.type === "focusout" ? event.relatedTarget : event.target;
    const part = place instanceof Element ? place.closest(".charts [data-slug]") : null;
    charts.classList.toggle("hot", part !== null);
    for (const one of all("[data-slug]", charts)) one.classList.toggle("on", part !== null && one.dataset.slug === part.dataset.slug);
  };
  for (const name of ["mouseover", "focusin", "mouseleave", "focusout"]) charts.addEventListener(name, heat);
  cut(charts, 50);
}

for (const id of ["track", "label", "find"]) document.getElementById(id)?.addEventListener("input", filter);
for (const id of ["robot", "measure"]) document.getElementById(id)?.addEventListener("input", () => { filter(); sortByRobot(); });

filter();
sortByRobot();
open();
