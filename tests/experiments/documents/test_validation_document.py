"""`legid.validation/1` as a struct: files of earlier versions are read, and its keys are told."""

from pathlib import Path

import pytest

import legid
from experiments.documents import Document, ValidationDocument
from experiments.reports import whole_validation_text
from tests.support.documented import DOCUMENTED, described, keys_table
from tests.support.earlier import FOLDER, again, earlier, written_by

EARLIER = earlier("validation")
"""As version 0.1 wrote it: no `start_s`."""


def test_a_document_of_an_earlier_version_is_read_and_told() -> None:
    found = legid.Validations.read(FOLDER / "validation.json")
    text = whole_validation_text(found)
    assert text.startswith("ROUGH: over 1 s it is.\nLook at it.\n") and "a.csv: the simulation diverged" in text
    assert "at 0.5 s 2 of 18 simulations of the model diverged" in text
    assert text.count("diverged") == 4 and " diverged " in text.split("fit, whole run")[1]
    assert "at 0.5 s a constant velocity predicts a joint better than the model" in text
    assert str(found).splitlines()[0] == "ROUGH: over 1 s it is."
    assert repr(found) == "<Validations: ROUGH: over 1 s it is.>"
    assert found.set_aside[0].run == "b.csv" and len(found) == 1
    assert found.to_frame().loc["a.csv", "q2_rad"] == 0.03 and "a.csv" in found._repr_html_()
    assert "Look at it." in written_by(found.page)
    for ask in (found.plot, lambda: found[0]):
        with pytest.raises(legid.WorkError, match="read from a file, which has no motion"):
            ask()


def test_what_was_read_is_written_as_it_was() -> None:
    kept = again(legid.Validations.read(FOLDER / "validation.json"))
    assert kept["runs"][0].pop("start_s") is None
    kept["provenance"]["runs"][0].pop("inside")
    assert kept == EARLIER and list(kept) == list(EARLIER)


def test_another_file_is_refused(tmp_path: Path) -> None:
    for text, told in (('{"schema": "legid.fit/1"}', "legid.fit/1"), ("[1, 2", "is no such document")):
        (tmp_path / "f.json").write_text(text)
        with pytest.raises(legid.InputError, match=told):
            ValidationDocument.read(tmp_path / "f.json")


@pytest.mark.parametrize("kind", DOCUMENTED.values())
def test_every_key_is_told(kind: type[Document]) -> None:
    rows = list(described(kind))
    assert [key for key, _, _ in rows] == list(kind.__struct_encode_fields__) and all(meaning for _, meaning, _ in rows)
    table = keys_table(kind)
    assert f"| `{rows[1][0]}` | {rows[1][1]} |" in table and "|  |" not in table
