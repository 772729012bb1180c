"""docs/schemas: one JSON Schema a document, as the structs are, which documents keep."""

import json
from dataclasses import replace
from math import inf

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest

from estimator import Combination, Diagnosis
from estimator.diagnosis import SensorGain
from experiments.documents import DiagnosisDocument, Document
from tests.support.diagnoses import synthetic
from tests.support.fits import document_of, synthetic_fit
from tests.tools.schemas import FOLDER, schemas

OPEN = replace(synthetic_fit(), converged=False, undetermined=(Combination((("beta8", 1.0),)),),
               covariance=np.diag([np.inf] * 9))


def test_the_files_are_current() -> None:
    """`python -m tests.tools.schemas` writes them."""
    assert {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()} == schemas()


@pytest.mark.parametrize("name, document", [
    ("fit", document_of(synthetic_fit())), ("fit", document_of(OPEN)),
    ("diagnosis", DiagnosisDocument.of(synthetic())), ("diagnosis", DiagnosisDocument.of(Diagnosis("fit_failed", "x"))),
    ("diagnosis", DiagnosisDocument.of(replace(synthetic(), sensors={"q1_rad": SensorGain(inf, inf, inf)})))])
def test_a_document_keeps_its_schema_and_can_be_read(name: str, document: Document) -> None:
    schema = json.loads(schemas()[f"legid.{name}-1.json"])
    jsonschema.validate(document.document, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**document.document, "schema": "legid.other/1"}, schema)
