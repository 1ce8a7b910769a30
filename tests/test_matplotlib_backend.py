"""Figures are drawn whatever MPLBACKEND names, and leave a caller's choice as it is."""

import os
import subprocess
import sys

import pytest
from result_samples import square_net, unfolding

import exunet

DRAW = """
import os, sys
import exunet
exunet.figure(exunet.load_result(sys.argv[1]), "reference_net").savefig(sys.argv[2])
import matplotlib
print(os.environ["MPLBACKEND"], matplotlib.rcParams._get_backend_or_none())
"""


@pytest.mark.parametrize(
    ("named", "chosen"),
    [("module://of.no", "module://of.no"), ("nonsense", None), ("svg", "svg")],
)
def test_figures_are_drawn_whatever_the_variable_names(tmp_path, named, chosen):
    exunet.save(unfolding(square_net(cells=2)), tmp_path / "result.h5")
    command = [sys.executable, "-c", DRAW, tmp_path / "result.h5", tmp_path / "net.png"]
    environment = os.environ | {"MPLBACKEND": named}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == f"{named} {chosen}\n", done.stderr
    assert (tmp_path / "net.png").stat().st_size > 1000
