"""`legid.fit/1` as a struct: files of earlier versions are read, shown and told, and what only a fit has is refused."""


import numpy as np
import pytest

import legid
from experiments.reports import fit_summary, fit_text
from tests.support.earlier import FOLDER, again, earlier, written_by
from tests.support.fits import document_of, synthetic_fit

LATER = earlier("fit_later")
"""With keys of later ones."""


def test_the_first_version_is_read_and_told() -> None:
    found = legid.FitResult.read(FOLDER / "fit.json")
    np.testing.assert_array_equal(found.beta, [0.1, np.nan, 0.2])
    np.testing.assert_array_equal(found.ci95()[0], [0.098, 0.102])
    assert found.fixed == {"beta9": 0.2} and found.trust.level == "caution" and list(found.std)[:1] == [0.001]
    text = found.text()
    assert "leg2, mle, sensors imu: 2000 samples, 8 iterations, 0.05 s" in text
    assert "torque residual (rms): joint 1 0.01 N m, joint 2 0.02 N m" in text and "beta8      not determined" in text
    assert list(found.to_frame()["fixed"]) == [False, False, True] and "beta8 " in found._repr_html_()


def test_what_later_versions_say_is_told() -> None:
    text = legid.FitResult.read(FOLDER / "fit_later.json").text().splitlines()
    assert text[:2] == ["DO NOT TRUST the parameters: these runs do not determine all parameters.", "Move it."]
    assert {"Warning: few samples", "assumed: noise is white",
            "the runs ask for larger tolerances: IMU 6 times"} <= set(text)
    assert any("torque 1 0.01 N m, torque 2 0.03 N m, accelerometer x 0.03" in line for line in text)
    assert any(line.startswith("runs disagree about beta1 (I1 + m1*lc1^2 + m2*l1^2): 0.080 .. 0.120") for line in text)
    assert "second opinion, by multiple shooting: largest disagreement 1.2 half widths, in beta1; not compared: " \
        "beta8" in text


def test_what_was_read_is_written_as_it_was() -> None:
    found = legid.FitResult.read(FOLDER / "fit_later.json")
    kept = again(found)
    assert kept["second_opinion"].pop("why") == "" and kept["provenance"]["runs"][0].pop("inside") == ""
    kept["provenance"] = {key: kept["provenance"][key] for key in LATER["provenance"]}
    assert {key: kept[key] for key in LATER} == LATER
    assert found.document["parameters"] == LATER["parameters"]


def test_a_file_has_no_motion() -> None:
    found = legid.FitResult.read(FOLDER / "fit.json")
    page = written_by(found.page)
    assert "<h2>Parameters</h2>" in page and "<h2>Torques</h2>" not in page
    for ask in (found.plot, lambda: found.covariance, lambda: legid.model(found)):
        with pytest.raises(legid.WorkError, match="read from a file, which has no covariance and no motion"):
            ask()


def test_a_joint_s_level_keeps_its_number() -> None:
    """The list of levels has one entry for each joint with a motor."""
    plain = document_of(synthetic_fit())
    assert plain.driven == (2,) and plain.levels == {"gyro_radps": 0.005, "accel_mps2": 0.05}
    plain.noise, plain.driven = {"torque_nm": 0.2, "torque_nm_by_joint": (0.1, 0.2)}, (2, 3)
    assert plain.levels == {"torque_nm": 0.2, "torque2_nm": 0.1, "torque3_nm": 0.2}


def test_samples_that_the_fit_left_out_are_told() -> None:
    fit = document_of(synthetic_fit())
    assert " 1500 samples," in fit_text(fit) and fit.recorded == 0
    fit.recorded = 1600
    assert " 1500 of 1600 samples," in fit_text(fit) and " 1500 of 1600 samples." in fit_summary(fit)
    fit.recorded = 1500
    assert " 1500 samples," in fit_text(fit)
