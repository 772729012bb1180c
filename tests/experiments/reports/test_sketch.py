"""The sketch of a mechanism: its places against the contract's geometry, its words, and that pages have it."""

import re

import numpy as np
import pytest

from estimator.model import biped3, chain, joint1, leg2
from experiments.reports.sketch import draw_mechanism, joint_places, sketch_pictures
from tests.support.fits import sections_of, synthetic_fit


def test_links_hang_one_on_the_other_and_grow_to_the_right() -> None:
    begin, end = joint_places(leg2(), np.array([0.5, 0.8]))
    assert end[0] == pytest.approx([np.sin(0.5), -np.cos(0.5)])
    assert begin[1] == pytest.approx(end[0])
    assert end[1] - begin[1] == pytest.approx([np.sin(1.3), -np.cos(1.3)])


def test_both_legs_and_torso_of_a_walker_start_at_the_hip() -> None:
    begin, end = joint_places(biped3(), np.array([0.2, 2.9, 0.4]))
    assert end[0] == pytest.approx([np.sin(0.2), np.cos(0.2)])
    assert begin[1] == pytest.approx(end[0]) and begin[2] == pytest.approx(end[0])


def test_the_caption_has_the_pose_the_motors_and_the_imu() -> None:
    poses = np.array([[0.0, 0.0], [0.5, -0.8], [np.nan, 3.0], [0.5, 0.2]])
    (picture,) = sketch_pictures(leg2(lever_arm=0.2), poses, np.array([5.0, 5.25, 5.5, 5.75]), "a.csv")
    caption = picture.caption
    assert "0.2 s into run a.csv: q1 = 0.50 rad, q2 = -0.80 rad" in caption
    assert "motor (joint 2)" in caption and "axes of an IMU" in caption
    assert all(f"<!-- {word} -->" in picture.svg or f">{word}<" in picture.svg
               for word in ("q1", "q2", "link 1", "link 2", "IMU", "x", "y", "g"))
    assert ">IMU<" not in draw_mechanism(chain(3), np.zeros(3))


@pytest.mark.parametrize(("pose", "anchor"), [(-0.5, "end"), (0.5, "start")])
def test_a_link_s_name_stands_on_the_far_side_of_its_angle(pose: float, anchor: str) -> None:
    svg = draw_mechanism(joint1(), np.array([pose]))
    place = r'text-anchor: (\w+)[^>]* x="([\d.]+)"[^>]*>'
    (link,), (angle,) = (re.findall(place + word, svg) for word in ("link 1<", "q1<"))
    assert link[0] == anchor and (float(link[1]) - float(angle[1])) * pose > 0.0


def test_a_slide_has_none_and_a_page_of_a_fit_has_one() -> None:
    assert sketch_pictures(joint1(prismatic=True), np.zeros((2, 1)), np.zeros(2), "") == []
    parameters = sections_of(synthetic_fit())[0]
    assert "Arrows show the sense" in parameters.pictures[0].caption
