// The emergency stop, the keyboard, the readings and the plots. Everything here works on elements that stay.
(() => {
  const WINDOW_S = 20, ACK_MS = 1000, STALE_MS = 2000, HERE_MS = 250;
  const by = (id) => document.getElementById(id);
  let running = false, latched = false, run = -1, lastShown = 0, rows = [], due = false, pressed = 0;

  const put = (element, text) => { if (element && element.textContent !== text) element.textContent = text; };

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

  // -- a page in front of somebody says so: a run that nobody watches stops
  setInterval(() => { if (!document.hidden) fetch("/here", { method: "POST" }).catch(() => {}); }, HERE_MS);

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
    if (event.repeat || !running) return;
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
  }, true);

  // -- readings
  function show(s) {
    lastShown = performance.now();
    running = s.running;
    latched = s.latched;
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
    else if (performance.now() - pressed > 5000) put(by("estop-said"), "Ready. Esc or Space does the same.");
  }

  setInterval(() => {
    if (!lastShown) return;
    const old = performance.now() - lastShown >= STALE_MS;
    by("cut").hidden = !old;
    if (old) { by("drive").dataset.drive = "unknown"; put(by("drive-words"), "UNCLEAR"); }
  }, 500);

  // -- plots
  const charts = () => [...document.querySelectorAll("[data-columns]")].map((box) => {
    const element = box.querySelector(".nicegui-echart");
    const chart = element && getElement(Number(element.id.replace(/^c/, "")))?.chart;
    return chart && { chart, columns: box.dataset.columns.split(",").map(Number) };
  }).filter(Boolean);

  function draw() {
    due = false;
    const last = rows.length ? rows.at(-1)[0] : 0;
    const min = Math.max(0, Math.ceil(last - WINDOW_S)), max = Math.max(WINDOW_S, Math.ceil(last));
    for (const { chart, columns } of charts()) {
      chart.setOption({
        xAxis: { min, max },
        series: columns.map((column) => ({ data: rows.map((row) => [row[0], row[column]]) })),
      }, { lazyUpdate: true, silent: true });
    }
  }

  function paint() {
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim();
    const found = charts();
    for (const { chart } of found) {
      const axis = { axisLabel: { color: color("--soft") }, nameTextStyle: { color: color("--soft") },
        axisLine: { lineStyle: { color: color("--rule") } }, splitLine: { lineStyle: { color: color("--grid") } } };
      chart.setOption({ color: [color("--line1"), color("--line2")], legend: { textStyle: { color: color("--ink") } },
        xAxis: axis, yAxis: axis });
    }
    if (found.length < document.querySelectorAll("[data-columns]").length) setTimeout(paint, 100);
    else draw();
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);

  window.legid = { show, paint };
})();
