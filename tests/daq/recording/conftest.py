"""What modules of this room share."""

import pytest

from drivers.mock import MockRig


@pytest.fixture
def mocks(monkeypatch: pytest.MonkeyPatch) -> list[MockRig]:
    """The rigs that a test makes."""
    made = []
    original = MockRig.__init__
    monkeypatch.setattr(MockRig, "__init__", lambda self, *a, **k: (made.append(self), original(self, *a, **k))[1])
    return made
