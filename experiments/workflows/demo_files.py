"""The files that a demo writes in addition to its runs."""

from __future__ import annotations

from pathlib import Path

from msgspec import structs

from estimator import FitResult
from estimator.prediction import PredictionTable, validations_of
from experiments.console import command_line, write_json, write_text
from experiments.documents import DiagnosisDocument, FitDocument, ValidationDocument
from experiments.judge import estimates_of, model_of, validation_trust
from experiments.models import save_model
from experiments.provenance import origin_of, source_of
from experiments.reports import (
    diagnosis_sections,
    fit_sections,
    fit_summary,
    model_with_origin,
    origin_section,
    standalone,
    truth_section,
    validation_picture,
    validation_section,
    write_page,
)
from experiments.workflows.demo_result import Demo


def write_results(out: Path, demo: Demo, benchmark: FitResult | None) -> dict[str, Path]:
    """Models, documents and both reports; returns what -> path."""
    result, setup = demo.result, demo.setup
    runs = [out / name for names in demo.diagnosis.runs.values() for name in names]
    origin = origin_of(sorted(runs), source_of(out / "rig.toml"), command=command_line())
    written = {"model": out / "model.json", "extended model": out / "extended.json", "fit": out / "fit.json",
               "diagnosis": out / "diagnosis.json", "validation": out / "validation.json",
               "picture": out / "picture.svg", "fit report": out / "fit.html", "report": out / "report.html"}
    model = model_of(result, setup.settings, setup.options.hold, [d.name for d in setup.datasets])
    save_model(model_with_origin(model, origin), written["model"])
    save_model(model_with_origin(demo.model, origin), written["extended model"])
    fit = structs.replace(FitDocument.of(result, setup.settings), provenance=origin)
    write_json(written["fit"], fit)
    diagnosis = structs.replace(DiagnosisDocument.of(demo.diagnosis, model=setup.settings.model), provenance=origin)
    write_json(written["diagnosis"], diagnosis)
    write_json(written["validation"], structs.replace(_validation(demo, demo.after), provenance=origin))
    write_text(written["picture"], standalone(validation_picture(validations_of(demo.after)[0])))
    sections = fit_sections(fit, result, benchmark)
    sections[1:1] = [truth_section(result.mechanism, estimates_of(result), demo.truth)]
    sections[-3:-3] = [validation_section(_validation(demo, demo.before), demo.before)]
    write_page(written["fit report"], "The emulated leg: the nominal fit", fit_summary(fit),
               [*sections, origin_section(origin)], origin, fit.headline)
    told, head = diagnosis_sections(diagnosis, demo.diagnosis), diagnosis.headline
    told[1:1] = [truth_section(setup.mechanism, demo.estimates(), demo.truth)]
    write_page(written["report"], f"The emulated leg: {head.title[:1].lower()}{head.title[1:]}",
               f"The leg was emulated. In addition to its rig file it had {demo.hidden.words}.",
               [*told, origin_section(origin)], origin, head)
    return written


def _validation(demo: Demo, table: PredictionTable) -> ValidationDocument:
    return ValidationDocument.of(table, validation_trust(table), demo.held)
