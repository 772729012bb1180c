"""Where a page comes from, and the command that takes its model to MuJoCo."""

from pathlib import Path

from msgspec.structs import replace

from experiments.provenance import origin_of, source_of
from experiments.reports import origin_section


def test_a_page_with_a_model_names_the_export(tmp_path: Path) -> None:
    model = tmp_path / "my model.json"
    model.write_text("{}")
    wanted = "This model in MuJoCo: legid export 'my model.json' --to mujoco --out leg; its errors there: " \
             "legid validate 'my model.json' RUN... --simulator mujoco"
    written = origin_of(command="legid fit run.csv --model-out 'my model.json'")
    for origin in (replace(origin_of(), model=source_of(model)), written):
        assert wanted in origin_section(origin).notes
    for command in ("", "legid fit run.csv"):
        assert not origin_section(origin_of(command=command)).notes
