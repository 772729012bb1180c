"""`Page`: the dashboard as one browser sees it."""

from __future__ import annotations

import html
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import msgspec
from nicegui import ui

from experiments.live.bench import Bench
from experiments.live.charts import CHARTS, options
from experiments.live.jobs import Job
from experiments.live.quality import Quality
from experiments.live.readings import limit_rows, readings
from experiments.live.session import Phase
from experiments.reports import whole_options

SHOW_EVERY_S = 0.22
"""At most five times a second."""
ESTOP = """<div id="estop-bar"><div id="estop-said" class="said" role="status" aria-live="assertive">Ready.</div>
<button id="estop" type="button" aria-keyshortcuts="Escape Space">EMERGENCY STOP</button></div>"""
CUT = ("No connection to legid live: the values shown are old, and the emergency stop here may not work. Use the "
       "switch on the rig.")


STOP = '<button id="stop" type="button" class="live-button">Stop</button>'
RELEASE = '<button id="release" type="button" class="live-button" hidden>Release the emergency stop</button>'
"""Plain buttons, like the emergency stop: page.js sends their requests. Stop is enabled in every state."""


class Page:
    """Built once for each browser; afterwards only what changed is sent."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self._session = bench, bench.session
        self._run = -1
        self._shown_rows = 0
        self._drawn = (-1, Phase.IDLE, False, "")
        self._failed: dict[str, str] = {}
        """Part of the page that could not be drawn the last time -> why."""
        self._checked: dict[Path, bool] = {}
        self._judged = 0
        self._listed: list[tuple[Path, Quality | None]] = []
        self._touched: set[Path] = set()
        """Runs that somebody has chosen or left out by hand."""

    def build(self) -> None:
        """The page's elements."""
        here = files("experiments.live")
        ui.add_head_html(f"<style>{(here / 'page.css').read_text(encoding='utf-8')}</style>")
        ui.add_body_html(f"{ESTOP}<script>{(here / 'page.js').read_text(encoding='utf-8')}</script>")
        self._top()
        with ui.element("main").classes("live-grid"):
            for parts in ((self._experiment, self._devices, self._limits), (self._plots, self._analysis)):
                with ui.element("div").classes("live-column"):
                    for part in parts:
                        self._attempt(part.__name__.strip("_"), part)
        self._client = ui.context.client
        self._client.run_javascript("legid.paint()")
        ui.timer(SHOW_EVERY_S, self._tick)
        ui.timer(0.0, self._look_for_plans, once=True)

    # -- parts ---------------------------------------------------------------------------------------------

    def _top(self) -> None:
        with ui.element("header").classes("live-top"):
            rig = html.escape(f"{self._bench.path} → {self._bench.out}")
            _html(f'<div class="live-title"><h1>legid live</h1><span class="soft">{rig}</span></div>'
                  '<div id="state" role="status" aria-live="polite" data-tone="calm"><div id="drive" data-drive="off">'
                  '<span class="shape" aria-hidden="true"></span><span id="drive-words">NOT DRIVEN</span></div>'
                  '<div class="state-words"><span id="phase">Idle</span> '
                  f'<span id="words"></span></div></div><div id="cut" role="alert" hidden>{CUT}</div>')
            self._trouble = ui.label().classes("trouble").props('role="alert"')
            self._trouble.set_visibility(False)

    def _experiment(self) -> None:
        with _card("Experiment"):
            self._plan = ui.select(self._plan_labels(), label="Torque plan").style("width: 100%")
            self._plan.props("for=plan outlined dense options-dense")
            self._plan.value = next(iter(self._plan.options), None)
            with ui.element("div").classes("live-buttons"):
                self._start = _button("Start", self._on_start, "start", "go")
                for button in STOP, RELEASE:
                    _html(button)
            self._unattended = ui.checkbox("Continue when no page is open (nobody watches the leg)").props(
                "for=unattended")
            _html('<progress id="progress" max="1" value="0" aria-label="share of the plan that is done"></progress>'
                  '<div class="soft">Time in the plan: <span id="time"></span></div><div id="silence"></div>')

    def _devices(self) -> None:
        with _card("Devices", "late"):
            names = {"controller": "Leg controller", "imu": "IMU", "motor": "Motor", "clock": "Clock bound",
                     "drops": "Drops"}
            _html('<dl class="facts">' + "".join(f'<dt>{label}</dt><dd id="{key}"></dd>'
                                                 for key, label in names.items()) + "</dl>")
            with ui.element("div").classes("live-buttons"):
                self._doctor = _button("Check the devices", lambda: self._bench.start_job("doctor", []), "doctor")
                self._clear = _button("Clear faults", lambda: self._bench.start_job("clear", []), "clear")
            with ui.element("div").props('id="checks"') as self._checks_box:
                pass

    def _limits(self) -> None:
        with _card("Limits", "last"):
            rows = "".join(
                f'<tr><th scope="row">{_quantity(what)}<div class="track"><div id="{key}-bar"></div></div></th>'
                f'<td id="{key}"></td><td>{bound:g}</td></tr>'
                for key, what, bound in limit_rows(self._bench.rig.limits))
            head = "".join(f'<th scope="col" class="{look}">{name}</th>' for name, look in
                           (("Quantity", ""), ("now", "number"), ("limit", "number")))
            _html(f'<table class="limits"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>')

    def _plots(self) -> None:
        with _card("Signals, the last 20 s"), ui.element("div").classes("plots"):
            for chart in CHARTS:
                columns = ",".join(str(column) for _, column in chart.series)
                names = "|".join(name for name, _ in chart.series)
                with ui.element("div").props(f'data-columns="{columns}" data-names="{names}"'):
                    _html(f"<h3>{chart.title}</h3>")
                    ui.echart(options(chart))

    def _analysis(self) -> None:
        with _card("Runs and what they say", "late"):
            with ui.element("div").classes("live-runs") as self._runs_box:
                pass
            with ui.element("div").classes("live-buttons"):
                self._fit = _button("Fit", lambda: self._bench.start_job("fit", self._chosen()), "fit")
                self._diagnose = _button("Diagnose", lambda: self._bench.start_job("diagnose", self._chosen()),
                                         "diagnose")
            self._why = ui.label().classes("soft")
            with ui.element("div").props('id="jobs"') as self._jobs_box:
                pass
        self._job_views: dict[int, JobView] = {}

    # -- what goes on --------------------------------------------------------------------------------------

    async def _on_start(self) -> None:
        if self._plan.value is not None and not self._bench.why_not_record():
            self._bench.stop_looking()
            await self._session.start(Path(self._plan.value), bool(self._unattended.value))
            self._unattended.value = False  # for this run, not for the next

    def _tick(self) -> None:
        """What stops and releases first."""
        self._client.run_javascript(f"legid.control({msgspec.json.encode(self._session.control).decode()})")
        for name, part in (("buttons", self._enable_buttons), ("readings", self._show),
                           ("list of runs", self._follow_runs), ("list of jobs", self._draw_jobs)):
            self._attempt(name, part)

    def _attempt(self, name: str, draw: Callable[[], None]) -> None:
        """Draw a part of the page. One that fails, by whatever file or disk, is named and keeps no other from being
        drawn."""
        try:
            draw()
        except Exception as error:
            self._failed[name] = str(error)
        else:
            self._failed.pop(name, None)
        words = "; ".join(f"{part}: {why}" for part, why in self._failed.items())
        self._trouble.set_text(f"Not shown: {words}")
        self._trouble.set_visibility(bool(words))

    def _show(self) -> None:
        session = self._session
        if session.run_number != self._run:
            self._run, self._shown_rows = session.run_number, 0
        document = readings(session, self._bench.rig, self._shown_rows)
        self._shown_rows = session.rows_seen
        self._client.run_javascript(f"legid.show({msgspec.json.encode(document).decode()})")

    def _follow_runs(self) -> None:
        session = self._session
        drawn = (session.run_number, session.phase, session.latched, self._bench.why_not())
        if drawn != self._drawn:
            if session.phase is Phase.FINISHED:
                self._next_plan()
            self._draw_runs()
            self._drawn = drawn
        self._bench.look_at_runs()
        if len(self._bench.quality) != self._judged:
            self._judged = len(self._bench.quality)
            self._draw_runs()

    def _enable_buttons(self) -> None:
        """By what is in memory alone."""
        why_not, chosen = self._bench.why_not(), len(self._chosen())
        self._start.set_enabled(not self._bench.why_not_record() and self._plan.value is not None)
        self._doctor.set_enabled(not why_not)
        self._clear.set_enabled(not why_not)
        self._fit.set_enabled(not why_not and chosen > 0)
        self._diagnose.set_enabled(not why_not and chosen > 0)
        count = f"{chosen} run{'s' * (chosen != 1)} chosen." if chosen else "Choose the runs to fit or diagnose."
        text = f"Not now: {why_not}." if why_not else count
        self._why.set_text(text if self._checked else "No runs yet: start an experiment.")

    async def _look_for_plans(self) -> None:
        await self._bench.look_for_plans()
        labels = self._plan_labels()
        chosen = self._plan.value if self._plan.value in labels else next(iter(labels), None)
        self._plan.set_options(labels, value=chosen)

    def _next_plan(self) -> None:
        """The first plan that this session has not recorded to its end."""
        done = {path.stem.split("-", 3)[-1] for path in self._session.finished}
        fresh = [path for path in self._plan.options if Path(path).stem not in done]
        if fresh:
            self._plan.set_value(fresh[0])

    def _draw_runs(self) -> None:
        """The list of runs with their quality, made anew when either changed.

        A run of this session is chosen when it was done to its end and is sound; what a person chose stays.
        """
        writing = self._session.run_path if self._session.running else None
        runs = [path for path in self._bench.runs() if path != writing]
        known = self._bench.quality
        for path in runs:
            if path not in self._touched:
                self._checked[path] = path in self._session.finished and path in known and known[path].sound
        self._checked = {path: self._checked.get(path, False) for path in runs}
        listed = [(path, known.get(path)) for path in runs]
        if listed == self._listed:
            return
        self._runs_box.clear()
        with self._runs_box:
            for path, quality in listed:
                note = "" if path in self._session.finished else "  (of an earlier session, or ended early)"
                ui.checkbox(f"{path.name}{note}", value=self._checked[path],
                            on_change=lambda e, p=path: self._check(p, e.value))
                look, words = _judgement(quality)
                _html(f'<div class="quality {look}">{html.escape(words)}</div>')
        self._listed = listed

    def _check(self, path: Path, chosen: bool) -> None:
        self._checked[path] = chosen
        self._touched.add(path)

    def _chosen(self) -> list[Path]:
        """Oldest first, as a diagnosis wants them."""
        return [path for path, chosen in self._checked.items() if chosen][::-1]

    def _draw_jobs(self) -> None:
        for job in reversed(self._bench.jobs):
            view, place = self._job_views.get(id(job)), self._checks_box if job.on_devices else self._jobs_box
            if view is None:
                with place:
                    view = self._job_views[id(job)] = JobView(job)
                view.box.move(place, 0)
            view.draw()
        for key in self._job_views.keys() - {id(job) for job in self._bench.jobs}:
            self._job_views.pop(key).box.delete()

    def _plan_labels(self) -> dict[str, str]:
        return {str(plan.path): plan.label for plan in self._bench.plans}


class JobView:
    """One job on one page."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._complete = False
        with ui.element("div").classes("job").props('role="status"') as self.box:
            self._title = ui.label().style("font-weight: 600")
            self._words = _html("")
            self._bar = ui.linear_progress(0.0, show_value=False).props("instant-feedback")

    def draw(self) -> None:
        """Bring it up to date; nothing is sent when nothing changed."""
        job = self._job
        if self._complete:
            return
        count = f" of {len(job.runs)} run{'s' if len(job.runs) != 1 else ''}" if job.runs else ""
        took = job.when or f"{job.seconds:.0f} s"
        self._title.set_text(f"{job.name}{count}: {job.state}, {took}")
        if job.state == "running":
            self._words.set_content(html.escape(job.progress))
            self._bar.set_value(job.fraction or 0.0)
            self._bar.props(add="indeterminate") if job.fraction is None else self._bar.props(remove="indeterminate")
            return
        self._complete = True
        self._words.set_content(whole_options(html.escape(job.verdict)))
        self._bar.set_visibility(False)
        with self.box:
            if job.report is not None:
                ui.link("Open the report", f"/report/{job.report.name}", new_tab=True)
            if job.on_devices:
                passed = [line for line in job.lines if line.startswith("ok ")]
                others = [line for line in job.lines if line not in passed]
                _html(f'<div class="checks">{"".join(map(_check, others))}<details><summary>{len(passed)} passed'
                      f'</summary>{"".join(map(_check, passed))}</details></div>')


def _judgement(quality: Quality | None) -> tuple[str, str]:
    """How a run's quality looks, and what it says."""
    if quality is None:
        return "", "being looked at"
    return ("ok", f"✓ sound: {quality.words}") if quality.sound else ("warn", f"⚠ not sound: {quality.words}")


def _card(title: str, place: str = "") -> ui.element:
    """A part of the page; on a phone those that are late come after the plots."""
    card = ui.element("section").classes(f"card {place}")
    with card:
        _html(f"<h2>{title}</h2>")
    return card


def _button(text: str, action: object | None, name: str, look: str = "") -> ui.button:
    button = ui.button(text, on_click=action, color=None)  # type: ignore[arg-type]
    return button.props(f'id="{name}" unelevated no-caps').classes(f"live-button {look}")


def _check(line: str) -> str:
    """A line of `legid doctor`: status, name, words."""
    status, *rest = html.escape(line).split(maxsplit=1)
    if status not in ("ok", "warn", "FAIL") or not rest:
        return ""
    name, _, words = rest[0].partition("  ")
    return f'<div><b class="{status}">{status}</b> <b>{name}</b> {whole_options(words.strip())}</div>'


def _quantity(what: str) -> str:
    """What is limited, so that no line ends between `in` and its unit."""
    return html.escape(what.replace("degC", "°C")).replace(" in ", " in&nbsp;").replace("N m", "N&nbsp;m")


def _html(text: str) -> ui.html:
    """Markup of our own; everything put into it is escaped."""
    return ui.html(text, sanitize=False)
