// The emergency stop, the keyboard, the readings and the plots. Everything here works on elements that stay.
(() => {
  const WINDOW_S = 20, ACK_MS = 1000, STALE_MS = 2000, HERE_MS = 250;
  const by = (id) => document.getElementById(id);
  let running = false, latched = false, run = -1, lastShown = 0, lastHeard = performance.now(), rows = [], due = false, pressed = 0;

  const keyboard = !matchMedia("(pointer: coarse)").matches;

  // an option is not parted at its hyphens: commands are copied from here
  const put = (element, text) => {
    if (!element || element.textContent === text) return;
    const whole = (option) => Object.assign(document.createElement("span"), { className: "whole", textContent: option });
    const parts = text.split(/((?<![\w-])--[a-z][\w-]*)/);
    if (parts.length > 1) element.replaceChildren(...parts.map((part, k) => (k % 2 ? whole(part) : part)));
    else element.textContent = text;
  };

  // -- who this browser is: only who pressed the emergency stop releases it, unless at the machine
  const who = (() => {
    const fresh = () => Array.from(crypto.getRandomValues(new Uint8Array(16)), (b) => b.toString(16)).join("");
    try { return localStorage.legidWho ??= fresh(); } catch { return fresh(); }
  })();
  const headers = { "X-Legid-Who": who };

  async function release() {
    try {
      const answer = await fetch("/release", { method: "POST", headers, signal: AbortSignal.timeout(ACK_MS) });
      if (answer.ok) return;
      put(by("words"), "Only who pressed it, or somebody at the machine, can release it.");
    } catch {
      put(by("words"), "Not released: legid live does not answer.");
    }
  }

  // -- Stop is always there; Release where the emergency stop is latched. Neither waits for the rest of the page
  function control(s) {
    lastHeard = performance.now();
    running = s.running;
    latched = s.latched;
    if (by("release")) by("release").hidden = !latched || running;
  }

  // -- a page in front of somebody says so: a run that nobody watches stops
  setInterval(async () => {
    if (document.hidden) return;
    try { control(await (await fetch("/here", { method: "POST" })).json()); } catch { /* `cut` says it */ }
  }, HERE_MS);

  async function stop() {
    try {
      const answer = await fetch("/stop", { method: "POST", keepalive: true, signal: AbortSignal.timeout(ACK_MS) });
      if (!answer.ok) throw new Error(answer.status);
    } catch {
      by("estop-said").className = "said failed";
      put(by("estop-said"), "Stop NOT SENT. Use the switch on the rig!");
    }
  }

  // -- emergency stop: a plain request, independent of the page's socket and of the plots
  async function emergency() {
    const now = performance.now();
    if (now - pressed < 300) return;
    pressed = now;
    by("estop-said").className = "said";
    put(by("estop-said"), "Sending …");
    try {
      const answer = await fetch("/emergency", { method: "POST", headers, keepalive: true, signal: AbortSignal.timeout(ACK_MS) });
      if (!answer.ok) throw new Error(answer.status);
      put(by("estop-said"), "Emergency stop sent.");
    } catch {
      by("estop-said").className = "said failed";
      put(by("estop-said"), "NOT SENT. Use the switch on the rig!");
    }
  }

  function keyed(event) {
    const unclear = performance.now() - lastHeard >= STALE_MS;
    if (event.repeat || !(running || unclear)) return;
    const typing = event.target.matches?.("input:not([type=checkbox]), textarea, select");
    if (event.key === "Escape" || (event.key === " " && !typing)) {
      event.preventDefault();
      event.stopPropagation();
      emergency();
    }
  }

  document.addEventListener("keydown", keyed, true);
  document.addEventListener("pointerdown", (event) => { if (event.target.closest?.("#estop")) emergency(); }, true);
  document.addEventListener("click", (event) => {
    if (event.target.closest?.("#estop")) emergency();
    if (event.target.closest?.("#release")) release();
    if (event.target.closest?.("#stop")) stop();
  }, true);

  // -- readings
  function show(s) {
    lastShown = performance.now();
    const state = by("state");
    if (state.dataset.tone !== s.tone) state.dataset.tone = s.tone;
    if (by("drive").dataset.drive !== s.drive) by("drive").dataset.drive = s.drive;
    put(by("drive-words"), s.driveWords);
    put(by("phase"), s.phase);
    put(by("words"), s.words);
    for (const [id, text] of Object.entries(s.text)) put(by(id), text);
    for (const [id, share] of Object.entries(s.bars)) {
      const bar = by(id + "-bar");
      if (!bar) continue;
      bar.style.width = (100 * share).toFixed(1) + "%";
      bar.classList.toggle("near", share > 0.8);
    }
    by("progress").value = s.progress;
    if (s.run !== run) { run = s.run; rows = []; }
    if (s.rows.length) rows = rows.concat(s.rows).filter((row) => row[0] >= s.rows.at(-1)[0] - WINDOW_S);
    if (s.rows.length && !due) { due = true; requestAnimationFrame(draw); }
    if (!running) put(by("estop-said"), latched ? "Pressed. Release it above to go on." : "Ready.");
    else if (performance.now() - pressed > 5000) put(by("estop-said"), keyboard ? "Ready. Esc or Space does the same." : "Ready.");
  }

  setInterval(() => {
    if (!lastShown) return;
    const old = performance.now() - lastShown >= STALE_MS;
    by("cut").hidden = !old;
    if (old) { by("drive").dataset.drive = "unknown"; put(by("drive-words"), "UNCLEAR"); }
  }, 500);

  // -- plots: two fingers, or the wheel with Ctrl, zoom all of them; double-click or two taps show all again
  let shown = [0, 100]; // per cent of the time axis

  function zoom(start, end) {
    const [from, to] = [Math.max(0, start), Math.min(100, end)];
    if (to - from < 1) return;
    shown = [from, to];
    for (const { chart } of charts()) chart.dispatchAction({ type: "dataZoom", start: from, end: to });
  }

  // pixel -> share of the axes' width, from 0 to 1
  function along(box, chart, clientX) {
    const { left, right } = chart.getOption().grid[0], outer = box.querySelector(".nicegui-echart").getBoundingClientRect();
    return (clientX - outer.left - left) / (outer.width - left - right);
  }

  function zoomable(box, chart) {
    const time = (share) => shown[0] + share * (shown[1] - shown[0]);
    const fingers = (event) => [...event.touches].map((t) => along(box, chart, t.clientX)).sort((a, b) => a - b);
    let held = null, tapped = 0;
    box.addEventListener("dblclick", () => zoom(0, 100));
    box.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      const at = time(along(box, chart, event.clientX)), factor = Math.exp(event.deltaY / 300);
      zoom(at - factor * (at - shown[0]), at + factor * (shown[1] - at));
    }, { passive: false });
    box.addEventListener("touchstart", (event) => {
      held = event.touches.length === 2 ? fingers(event).map(time) : null;
    }, { passive: true });
    box.addEventListener("touchmove", (event) => {
      if (!held || event.touches.length !== 2) return;
      event.preventDefault();
      const [left, right] = fingers(event), slope = (held[1] - held[0]) / Math.max(right - left, 0.02);
      zoom(held[0] - slope * left, held[0] + slope * (1 - left));
    }, { passive: false });
    box.addEventListener("touchend", (event) => {
      if (held || event.touches.length) { tapped = 0; return; }
      if (event.timeStamp - tapped < 350) zoom(0, 100);
      tapped = event.timeStamp;
    }, { passive: true });
  }

  const charts = () => [...document.querySelectorAll("[data-columns]")].map((box) => {
    const element = box.querySelector(".nicegui-echart");
    const chart = element && getElement(Number(element.id.replace(/^c/, "")))?.chart;
    return chart && { box, chart, columns: box.dataset.columns.split(",").map(Number), names: box.dataset.names.split("|") };
  }).filter(Boolean);

  function draw() {
    due = false;
    const last = rows.length ? rows.at(-1)[0] : 0;
    const min = Math.max(0, Math.ceil(last - WINDOW_S)), max = Math.max(WINDOW_S, Math.ceil(last));
    for (const { chart, columns, names } of charts()) {
      const measured = columns.map((column) => rows.some((row) => row[column] != null)); // of the others no legend speaks
      chart.setOption({
        legend: { data: measured.includes(true) ? names.filter((_, k) => measured[k]) : names },
        xAxis: { min, max },
        series: columns.map((column) => ({ data: rows.map((row) => [row[0], row[column]]) })),
      }, { lazyUpdate: true, silent: true });
    }
  }

  function paint() {
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim();
    const found = charts();
    for (const { box, chart } of found) {
      if (!box.dataset.zooms) { box.dataset.zooms = "yes"; zoomable(box, chart); }
      const axis = { axisLabel: { color: color("--soft"), formatter: (value) => String(Number(value.toPrecision(3))) }, nameTextStyle: { color: color("--soft") },
        axisLine: { lineStyle: { color: color("--rule") } }, splitLine: { lineStyle: { color: color("--grid") } } };
      chart.setOption({ color: [color("--line1"), color("--line2"), color("--line1")], legend: { textStyle: { color: color("--ink") } },
        xAxis: axis, yAxis: axis });
    }
    if (found.length < document.querySelectorAll("[data-columns]").length) setTimeout(paint, 100);
    else draw();
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);

  window.legid = { control, show, paint };
})();
