// Reading values off the curves. Without it the page shows those of the last step.

// The values of every chart of a robot at a place, 0 (first step) to 100 (last): each line's nearest point.
function read(section, place) {
  const last = Number(section.dataset.last);
  section.querySelector(".slider input").value = place;
  section.querySelector(".slider output").textContent = Math.round(place / 100 * last).toLocaleString("en");
  for (const panel of all(".panel", section)) {
    for (const end of ["x1", "x2"]) panel.querySelector(".cursor").setAttribute(end, place);
    const rows = all(".key li", panel);
    all("g[data-slug]", panel).forEach((line, number) => {
      const readings = line.readings ??= JSON.parse(line.dataset.readings);
      const [, mean, interval] = readings.reduce((best, one) => Math.abs(one[0] - place) <= Math.abs(best[0] - place) ? one : best);
      const value = rows[number].querySelector(".value"), span = value.querySelector(".interval");
      value.firstChild.textContent = `${mean} `;
      span.textContent = interval;
    });
  }
}

for (const section of all(".robot")) {
  section.querySelector(".slider input").addEventListener("input", event => read(section, Number(event.target.value)));
  for (const drawing of all(".plot svg", section)) {
    const point = event => {
      const box = drawing.getBoundingClientRect();
      read(section, Math.round(200 * Math.min(1, Math.max(0, (event.clientX - box.left) / box.width))) / 2);
    };
    for (const name of ["pointermove", "pointerdown"]) drawing.addEventListener(name, point);
  }
  // The group that is pointed at stands out in every chart of the robot.
  const charts = section.querySelector(".charts");
  const heat = event => {
    const part = event.type !== "mouseleave" && event.target instanceof Element ? event.target.closest(".charts [data-slug]") : null;
    charts.classList.toggle("hot", part !== null);
    for (const one of all("[data-slug]", charts)) one.classList.toggle("on", part !== null && one.dataset.slug === part.dataset.slug);
  };
  for (const name of ["mouseover", "mouseleave"]) charts.addEventListener(name, heat);
  read(section, 100);
}

open();
