"""Every case file of the project is valid, and its first moments run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet

CASES = Path(__file__).parent.parent / "cases"


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_case_runs(path):
    result = exunet.run(exunet.load(path, ["time.end=0.6", "time.output_step=0.1"]))
    assert result.complete
    assert result.time[-1] == 0.6
    assert np.isfinite(result.position).all()
    assert result.tension.min() >= 0.0
