"""The drivers on a real Linux kernel's I2C and CAN: the tests of guest_*.py, run inside user-mode-linux."""

import pytest

from tests.kernel import uml


@pytest.mark.slow
def test_drivers_on_a_real_kernel(capsys: pytest.CaptureFixture[str]) -> None:
    try:
        outcome = uml.run()
    except uml.Unavailable as error:
        pytest.skip(f"no kernel to test on: {error}")
    with capsys.disabled():
        print(f"\n{outcome}")
    assert outcome.status == 0, outcome.output
    assert " passed" in outcome.output or "[100%]" in outcome.output
