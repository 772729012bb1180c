// Figures that zoom: drag over one, or spread two fingers on it; double-click or tap twice to see all. Those of one group
// share their time.
(() => {
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const groups = {}, drawn = [];

  function follow(u, key, group) {
    if (key !== "x") return;
    const { min, max } = u.scales.x;
    for (const other of groups[group])
      if (other !== u && (other.scales.x.min !== min || other.scales.x.max !== max)) other.setScale("x", { min, max });
  }

  // two fingers hold the times that they were put on; one finger scrolls the page
  function pinch(u, time) {
    const all = { min: time[0], max: time.at(-1) };
    const fingers = (event) => [...event.touches].map((t) => t.clientX - u.over.getBoundingClientRect().left).sort((a, b) => a - b);
    let held = null, tapped = 0;
    u.over.addEventListener("touchstart", (event) => {
      held = event.touches.length === 2 ? fingers(event).map((x) => u.posToVal(x, "x")) : null;
    }, { passive: true });
    u.over.addEventListener("touchmove", (event) => {
      if (!held || event.touches.length !== 2) return;
      event.preventDefault();
      const [left, right] = fingers(event), slope = (held[1] - held[0]) / (right - left), begin = held[0] - slope * left;
      const min = Math.max(all.min, begin), max = Math.min(all.max, begin + slope * u.over.clientWidth);
      if (right - left > 8 && max - min > 1e-3) u.setScale("x", { min, max });
    }, { passive: false });
    u.over.addEventListener("touchend", (event) => {
      if (held || event.touches.length) { tapped = 0; return; }
      if (event.timeStamp - tapped < 350) u.setScale("x", all);
      tapped = event.timeStamp;
    }, { passive: true });
  }

  // marks of an axis with as many digits as its steps have
  const marks = (u, values, axis, space, step) => values.map((x) => {
    const digits = Math.ceil(-Math.log10(step) - 1e-9) + 1;
    return Math.abs(x) < step / 2 ? "0" : digits > 5 || step >= 1e5
      ? Number(x).toExponential(Math.max(0, Math.round(Math.log10(Math.abs(x))) + digits)).replace(/\.?0*e\+?/, "e")
      : String(Number(x.toFixed(Math.max(digits, 0))));
  });

  function panel(box, given, lines, y, height) {
    const axis = (label, size) => ({ label, size, labelSize: 22, stroke: () => css("--soft"), labelFont: "12px system-ui",
      grid: { stroke: () => css("--grid"), width: 1 }, ticks: { stroke: () => css("--grid"), width: 1 }, values: marks, font: "12px system-ui" });
    const size = () => ({ width: Math.max(box.clientWidth, 200), height });
    const number = (u, value) => (value == null ? "–" : String(Number(value.toPrecision(4))));
    const group = given.group;
    const u = new uPlot({
      ...size(),
      cursor: { sync: { key: group }, drag: { x: true, y: false }, points: { size: 6 } },
      scales: { x: { time: false } },
      axes: [axis(given.x, 44), { ...axis(y, (u, shown) => 16 + 7 * Math.max(4, ...(shown ?? []).map((x) => x.length))), space: 20 }],
      series: [{ label: given.x, value: number }, ...lines.map((line) => ({
        label: line.label, stroke: line.colour, width: line.width,
        dash: line.dashed ? [6, 4] : undefined, value: number, points: { show: false }, spanGaps: false }))],
      hooks: { setScale: [(plot, key) => follow(plot, key, group)] },
    }, [given.time, ...lines.map((line) => line.values)], box);
    (groups[group] ??= []).push(u);
    drawn.push(u);
    pinch(u, given.time);
    new ResizeObserver(() => { if (box.clientWidth && Math.abs(u.width - box.clientWidth) > 1) u.setSize(size()); }).observe(box);
  }

  function draw(figure) {
    const given = JSON.parse(figure.querySelector("script").textContent), box = document.createElement("div");
    const below = given.lines.filter((line) => line.below);
    box.className = "plot";
    figure.prepend(box);
    figure.classList.add("drawn");
    panel(box, given, given.lines.filter((line) => !line.below), given.y, 280);
    if (below.length) panel(box, given, below, given.below, 190);
  }

  document.querySelectorAll("figure.chart").forEach(draw);
  document.documentElement.classList.add("interactive");
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((u) => u.redraw(false, true)));
})();
