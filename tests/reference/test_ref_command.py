"""The command line of reference_impl: exit codes, messages, the result file, independence."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import reference_impl.__main__ as command
from reference_impl import read, weave

ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT / "cases" / "planar_deployment.toml"
STORED = ["--set", "time.output_step=0.005"]
SHORT = ["--set", "time.end=0.02", *STORED]


@pytest.fixture
def run(tmp_path, capsys):
    """run(*arguments): exit code, lines on stderr, content of the result file or None."""

    def call(*arguments):
        out = tmp_path / "out.npz"
        code = command.main([*map(str, arguments), "-o", str(out)])
        content = dict(np.load(out)) if out.exists() else None
        assert [p.name for p in tmp_path.iterdir() if p.suffix == ".part"] == []
        return code, capsys.readouterr().err.splitlines(), content

    return call


def test_result_file(run):
    code, lines, got = run(CASE, *SHORT, "--symmetric")
    assert (code, lines) == (0, [])
    net = weave(read(CASE))
    nt, n, m = 5, 40, 64
    shapes = {
        "format": (),
        "complete": (),
        "provenance": (),
        "t": (nt,),
        "position": (nt, n, 3),
        "velocity": (nt, n, 3),
        "reference_position": (n, 3),
        "element_nodes": (m, 2),
        "reference_length": (m,),
        "area": (m,),
        "youngs_modulus": (m,),
        "density": (m,),
        "mass": (n,),
        "bullet_nodes": (4,),
        "fixed_nodes": (0,),
        "strain": (nt, m),
        "tension": (nt, m),
        "kinetic": (nt,),
        "elastic": (nt,),
        "potential": (nt,),
        "dissipated": (nt,),
        "momentum": (nt, 3),
        "angular_momentum": (nt, 3),
        "body_names": (0,),
        "body_mass": (0,),
        "body_inertia": (0, 3),
        "body_products_of_inertia": (0, 3),
        "body_centre_of_mass": (0, 3),
        "body_position": (nt, 0, 3),
        "body_velocity": (nt, 0, 3),
        "body_attitude": (nt, 0, 3, 3),
        "body_angular_velocity": (nt, 0, 3),
        "body_impulse": (nt, 0, 3),
        "body_angular_impulse": (nt, 0, 3),
        "body_work": (nt, 0),
        "reel_names": (0,),
        "reel_wound_up": (nt, 0),
        "reel_held": (nt, 0),
        "reel_work": (nt, 0),
        "closing_wound_up": (nt, 0),
        "closing_part": (nt, 0),
        "closing_work": (nt, 0),
        "closing_tension": (nt, 0),
        "intact": (nt, m),
        "contact_damping": (nt,),
        "contact_friction": (nt,),
        "contact_depth": (nt,),
        "break_element": (0,),
        "break_time": (0,),
        "break_energy": (0,),
    }
    assert {key: value.shape for key, value in got.items()} == shapes
    assert got["complete"]
    assert np.array_equal(got["mass"], net.mass)
    assert got["strain"][0] == pytest.approx([(0.1**2 - 1) / 2] * m)
    assert got["kinetic"][0] == pytest.approx(6.404390, abs=1e-6)
    facts = json.loads(str(got["provenance"]))
    assert facts["case"] == CASE.read_text()
    assert facts["overrides"] == {"time.end": 0.02, "time.output_step": 0.005}
    assert (facts["method"], facts["rtol"], facts["atol"], facts["step"]) == ("DOP853", 1e-10, 1e-12, None)
    assert facts["n_steps"] > 0
    assert set(facts) >= {
        "n_rhs",
        "n_newton",
        "n_halvings",
        "assembled",
        "python",
        "numpy",
        "scipy",
        "wall_s",
        "symmetric",
    }


def test_result_file_of_a_body_with_a_frame(run):
    """Moments, products and centre of mass as given; the frame's origin is found again from the file."""
    keys = "mass=2.0,inertia=[1.5,2.0,2.5],products_of_inertia=[0.1,-0.2,0.3],centre_of_mass=[0.5,0.0,0.0]"
    start = "position=[1.0,2.0,3.0],axis=[0.0,0.0,1.0],angle=0.5,angular_velocity=[0.0,0.0,1.0]"
    got = run(CASE, *SHORT, "--set", f"bodies.box={{{keys},{start}}}")[2]
    assert got["body_inertia"].tolist() == [[1.5, 2.0, 2.5]]
    assert got["body_products_of_inertia"].tolist() == [[0.1, -0.2, 0.3]]
    assert got["body_centre_of_mass"].tolist() == [[0.5, 0.0, 0.0]]
    origin = got["body_position"][0, 0] - got["body_attitude"][0, 0] @ got["body_centre_of_mass"][0]
    assert origin == pytest.approx([1.0, 2.0, 3.0], rel=1e-15)


def test_result_file_with_bodies_and_breaks(run):
    """The chaser of a launch is a body; a break is recorded, and energies of the file add up."""
    launched = run(ROOT / "cases" / "effects" / "launch_force.toml", *SHORT)[2]
    assert launched["body_names"].tolist() == ["chaser"]
    assert launched["body_mass"].tolist() == [50.0]
    assert not launched["body_inertia"].any()
    assert launched["body_position"].shape == launched["body_velocity"].shape == (5, 1, 3)
    assert np.array_equal(launched["body_attitude"], np.broadcast_to(np.eye(3), (5, 1, 3, 3)))
    assert np.abs(launched["momentum"]).max() < 1e-14
    broken = run(ROOT / "cases" / "effects" / "breaking.toml")[2]
    assert broken["break_element"].tolist() == [0]
    assert np.array_equal(broken["intact"][:, 0], broken["t"] < broken["break_time"][0])
    assert broken["dissipated"][-1] == broken["break_energy"][0] > 0.0
    assert not broken["tension"][-1].any()
    for got in (launched, broken):
        total = got["kinetic"] + got["elastic"] + got["potential"] + got["dissipated"]
        assert np.ptp(total) < 1e-10 * total[0]
        assert json.loads(str(got["provenance"]))["n_steps"] > 0


def test_same_command_same_numbers(run):
    first, second = (run(CASE, *SHORT, "--method", "RK4", "--step", "1e-4")[2] for _ in range(2))
    assert all(np.array_equal(first[key], second[key]) for key in first if key != "provenance")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([CASE, "--set", "effects.drag.rho=1"], "reference_impl does not know effects.drag"),
        ([CASE, "--set", "net.size=wide"], "net.size: must be a number"),
        ([CASE, "--set", "net.size"], "expected key.path=value"),
        (
            [ROOT / "cases/effects/air_drag.toml", "--method", "EM", "--step", "0.1"],
            "do it with effects.air_drag",
        ),
        ([CASE, "--method", "RK4"], "--step"),
        ([CASE, "--step", "0.1"], "--step"),
        ([CASE, "--method", "Euler"], "invalid choice"),
        ([CASE, "--rtol", "-1"], "not a finite number"),
        ([CASE, "--sideways"], "--sideways"),
        ([ROOT / "no.toml"], "No such file"),
        ([], "required"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(run, arguments, says):
    code, lines, got = run(*arguments)
    assert (code, got) == (2, None)
    assert len(lines) == 1
    assert says in lines[0]


def test_one_line_for_each_fault(run):
    code, lines, _ = run(CASE, "--set", "net.colour=1", "--set", "time.end=soon")
    assert code == 2
    assert len(lines) == 2


def test_output_must_be_writable(tmp_path, capsys):
    for out in (tmp_path, tmp_path / "none" / "out.npz"):
        assert command.main([str(CASE), "-o", str(out)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


def test_divergence_keeps_what_was_computed(run):
    code, lines, got = run(CASE, "--method", "RK4", "--step", "2e-3", "--set", "time.end=1.0", *STORED)
    assert code == 3
    assert len(lines) == 1
    assert all(word in lines[0] for word in ("t = ", "element", "Try --step"))
    assert not got["complete"]
    assert 1 < len(got["t"]) < 201


def test_interruption_keeps_what_was_computed(run, monkeypatch):
    def stop(time, end):
        if time > 0.01:
            raise KeyboardInterrupt

    monkeypatch.setattr(command, "integrate", partial(command.integrate, progress=stop))
    code, lines, got = run(CASE, *SHORT)
    assert (code, len(lines)) == (130, 1)
    assert not got["complete"]
    assert got["t"].tolist() == [0.0, 0.005, 0.01, 0.015]


@pytest.mark.ci
@pytest.mark.slow
def test_runs_as_a_module(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "reference_impl", str(CASE), "-o", str(tmp_path / "a.npz"), *SHORT],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "a.npz").exists()


@pytest.mark.ci
@pytest.mark.slow
def test_imports_nothing_it_should_be_independent_of():
    allowed = {"__future__", "reference_impl", "numpy", "scipy", *sys.stdlib_module_names}
    for path in (ROOT / "reference_impl").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = (
                [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else ([node.module] if isinstance(node, ast.ImportFrom) else [])
            )
            assert {name.split(".")[0] for name in names} <= allowed, path
