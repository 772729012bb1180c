// Figures that zoom: drag over one to zoom in, double-click to see all. Those of one group share their time.
(() => {
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const groups = {}, drawn = [];

  function follow(u, key, group) {
    if (key !== "x") return;
    const { min, max } = u.scales.x;
    for (const other of groups[group])
      if (other !== u && (other.scales.x.min !== min || other.scales.x.max !== max)) other.setScale("x", { min, max });
  }

  function draw(figure) {
    const given = JSON.parse(figure.querySelector("script").textContent), box = document.createElement("div");
    const axis = (label, size) => ({ label, size, labelSize: 22, stroke: () => css("--soft"), labelFont: "12px system-ui",
      grid: { stroke: () => css("--grid"), width: 1 }, ticks: { stroke: () => css("--grid"), width: 1 }, font: "12px system-ui" });
    const size = () => ({ width: Math.max(box.clientWidth, 200), height: 280 });
    const number = (u, value) => (value == null ? "–" : String(Number(value.toPrecision(4))));
    box.className = "plot";
    figure.prepend(box);
    figure.classList.add("drawn");
    const group = given.group;
    const u = new uPlot({
      ...size(),
      cursor: { sync: { key: group }, drag: { x: true, y: false }, points: { size: 6 } },
      scales: { x: { time: false } },
      axes: [axis(given.x, 44), axis(given.y, 62), ...(given.lines.some((line) => line.right)
        ? [{ ...axis("error", 56), scale: "right", side: 1, grid: { show: false } }] : [])],
      series: [{ label: given.x, value: number }, ...given.lines.map((line) => ({
        label: line.label, class: line.band ? "band" : undefined, scale: line.right ? "right" : "y", stroke: line.colour, width: line.width, dash: line.dashed ? [6, 4] : undefined,
        value: number, points: { show: false }, spanGaps: false }))],
      bands: given.bands.map(([high, low, fill]) => ({ series: [high, low], fill })),
      hooks: { setScale: [(plot, key) => follow(plot, key, group)] },
    }, [given.time, ...given.lines.map((line) => line.values)], box);
    (groups[group] ??= []).push(u);
    drawn.push(u);
    new ResizeObserver(() => { if (box.clientWidth && Math.abs(u.width - box.clientWidth) > 1) u.setSize(size()); }).observe(box);
  }

  document.querySelectorAll("figure.chart").forEach(draw);
  document.documentElement.classList.add("interactive");
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((u) => u.redraw(false, true)));
})();
