"""The command as its user meets it: exit codes, files, words."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from commands import WRITING_OFTEN, command, ended, process, states_stored, wait_until

import exunet
from exunet.base.version import VERSION
from exunet.cli.main import main

CASES = Path(__file__).parent.parent / "cases"
PLANAR = CASES / "planar_deployment.toml"
SHORT = ("--set", "time.end=0.02", "--set", "time.output_step=0.01")
COMMANDS = ("run", "ensemble", "resume", "check", "effects", "schema", "verify", "cost", "compare", "plot")
# Nothing is taut within 0.02 s: no figure of tensions.
FIGURES = {"reference_net.png", "snapshots.png", "bullet_speeds.png", "energies.png", "area.png"}


def written(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_run_writes_result_summary_and_figures_only(tmp_path):
    done = ended(process("run", PLANAR, *SHORT, "--spread", 8, folder=tmp_path))
    assert done.returncode == 0, done.stderr
    expected, *_ = (line for line in done.stderr.splitlines() if not line.startswith("compil"))
    assert expected.startswith("expected: ")
    names = {"result.h5", "summary.json", "spread.h5"} | FIGURES
    folder = tmp_path / "results/planar_deployment--time.end=0.02--time.output_step=0.01"
    assert written(folder) == names
    assert {path.name for path in tmp_path.rglob("*")} == names | {"results", folder.name}
    summary = json.loads((folder / "summary.json").read_text())
    result = exunet.load_result(folder / "result.h5")
    assert summary["verdict"] == result.verdict == "ok"
    rows = ("nodes, elements", "mass", "method", "steps", "right-hand sides", "wall time", "energy balance")
    for row in (*rows, "largest area", "time of largest", "distance", "area above 80 %"):
        assert row in done.stdout
    assert f"{summary['mass_kg']:.6f} kg" in done.stdout
    build, integration = (summary["cost"][f"{name}_s"] for name in ("build", "integration"))
    assert f"{build:.2f} s build, {integration:.2f} s integration" in done.stdout
    assert result.provenance["text"] == PLANAR.read_text()
    assert result.provenance["overrides"] == [SHORT[1], SHORT[3]]


@pytest.mark.slow
def test_check_adds_the_reference(tmp_path):
    done = command("run", PLANAR, "--check", *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    check = json.loads((tmp_path / "here/summary.json").read_text())["check"]
    assert check["agrees_until_s"] is None
    assert 0 <= check["speed_difference"]["largest_m_s"] < 1e-12  # free flight: round-off only
    assert "check: agrees until" in done.stdout
    assert (tmp_path / "here/agreement.png").stat().st_size > 10_000


@pytest.mark.slow
def test_plot_draws_the_figures_again(tmp_path):
    command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    done = command("plot", "here/result.h5", "--out", "again", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    for name in FIGURES:
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


@pytest.mark.ci
@pytest.mark.slow
def test_check_command_says_what_would_be_simulated(tmp_path):
    done = command("check", PLANAR, folder=tmp_path)
    assert done.returncode == 0
    for words in ("40, 64", "2.360819 kg", "rayleigh_damping", "gravity", "DOPRI5", "stable step",
                  "64 ObjectConnectorSpringDamper", "40 MassPoint", "1 ObjectGenericODE2"):  # fmt: skip
        assert words in " ".join(done.stdout.split())  # folded
    for row in ("wall time", "disk", "runs beside"):
        assert row in done.stdout
    bare = command("check", CASES / "planar_undamped.toml", folder=tmp_path)
    assert "ObjectGenericODE2" not in bare.stdout  # no damping object where there is no damping
    assert written(tmp_path) == set()


@pytest.mark.slow
def test_check_command_names_bodies_and_point_masses(tmp_path):
    """Also with the compiled loop, which has no engine items."""
    body = (
        "bodies.target={mass=7.0,inertia=[2.0,3.0,4.0],position=[0.0,0.0,9.0],angular_velocity=[0.0,0.0,0.1]}"
    )
    launched = CASES / "effects" / "launch_force.toml"
    done = command("check", launched, "--set", body, "--set", "engine.backend=compiled", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    stdout = " ".join(done.stdout.split())  # the table folds long rows
    assert "body target 7 kg, free" in stdout
    assert "target: inertia 2, 3, 4 kg m2 about the centre of mass and the principal axes (1, 0, 0)" in stdout
    assert "target: at the start centre of mass at (0, 0, 9) m with (0, 0, 0) m/s in the scene's" in stdout
    assert "turns at (0, 0, 0.1) rad/s in the body's axes" in stdout
    assert "point mass chaser 50 kg, at (0, 0, 0) m with (0, 0, 0) m/s in the scene's axes" in stdout
    assert "none: compiled loop" in stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "absent.toml"], ["absent.toml"]),
        (["run", "."], ["is a folder"]),
        (["run", ""], ["name of a file or folder is empty"]),
        (["run", PLANAR, "--out", ""], ["name of a file or folder is empty"]),
        (["check", PLANAR, "--set", "net.mesh=0.7"], ["net.mesh", "whole number"]),
        (["run", PLANAR, "--set", "time.end=0"], ["time.end", "greater than 0"]),
        (["run", PLANAR, "--set", "solver.method=RK4"], ["solver.method", "RK44"]),
        (["run", PLANAR, "--set", "net.cable.diametr=1"], ["net.cable.diametr", "diameter"]),
        (["run", PLANAR, "--out", PLANAR], ["planar_deployment.toml", "cannot be written"]),
        (["run", PLANAR, "--out", "/proc/no"], ["/proc/no", "cannot be written"]),
        (["plot", PLANAR], ["not a result file"]),
        (["plot", "absent.h5"], ["absent.h5", "No such file"]),
        (["schema", "--json", "--template"], ["one of them"]),
    ],
)
def test_bad_input_ends_with_code_2_and_writes_nothing(tmp_path, arguments, words):
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 2, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
    for word in words:
        assert word in done.stderr


@pytest.mark.slow
def test_a_process_ends_with_code_2_too(tmp_path):
    """As the tests above, which call the command in this process."""
    done = ended(process("run", "absent.toml", folder=tmp_path))
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("absent.toml: ")
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_all_faults_are_reported_at_once(tmp_path):
    case = tmp_path / "bad.toml"
    text = PLANAR.read_text().replace("mass = 0.5", "mass = -0.5").replace("end = 2.0", "end = nan")
    case.write_text(text.replace("radial_speed", "radial_sped"))
    done = command("run", "bad.toml", folder=tmp_path)
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    places = [line.split(": ")[:2] for line in lines]
    numbered = text.splitlines()
    for start, key in (("mass = -0.5", "net.bullets.mass"), ("end = nan", "time.end")):
        number = next(n for n, line in enumerate(numbered, 1) if line.startswith(start))
        assert [f"bad.toml:{number}", key] in places
    assert any("radial_sped" in line and "radial_speed" in line for line in lines)


def test_a_step_100_times_too_large_is_refused(tmp_path):
    done = command(
        "run", PLANAR, "--set", "solver.method=RK44", "--set", "solver.step=2.5e-2",  # stable: 2.5e-4 s
        "--set", "time.output_step=0.1", "--out", "here", folder=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2
    for words in ("--set solver.step=2.5e-2: solver.step: 0.025 s is", "0.0002548 s", "solver.force"):
        assert words in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("youngs_modulus = 70e9", "youngs_modulus = 1e308", "net.cable.youngs_modulus", "1e+308"),
        ("density = 1390.0", "density = 1e308", "net.cable.density", "1e+308"),
        ("mass = 0.5", "mass = 1e308", "net.bullets.mass", "1e+308"),
        ("radial_speed = 2.5", "radial_speed = 1e200", "launch.radial_speed", "kinetic energy at the start"),
        ("packing = 0.1", "packing = 1e300", "initial.packing", "elastic energy at the start"),
        ('method = "DOPRI5"', 'method = "RK44"\nstep = 0.0255', "solver.step",
         "0.0255 s (shortened to the 0.001 s between stored times) is above the stable step 0.0002548 s"),
    ],
)  # fmt: skip
def test_faults_found_in_preparing_a_run_have_their_line(tmp_path, old, new, key, words):
    """The stable step is that of tests/test_stability.py."""
    text = PLANAR.read_text().replace(old, new, 1)
    (tmp_path / "bad.toml").write_text(text)
    last = new.splitlines()[-1]
    number = next(n for n, line in enumerate(text.splitlines(), 1) if line.startswith(last))
    for what in ("run", "check"):
        done = command(what, "bad.toml", folder=tmp_path)
        assert done.returncode == 2, done.stdout + done.stderr
        assert done.stderr.startswith(f"bad.toml:{number}: {key}: ")
        assert words in done.stderr
        assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"]


@pytest.mark.slow
def test_a_forced_step_100_times_too_large_diverges_and_is_kept(tmp_path):
    done = command(
        "run", PLANAR, "--set", "solver.method=RK44", "--set", "solver.step=2.5e-2",
        "--set", "solver.force=true", "--set", "time.output_step=0.1", "--out", "here", folder=tmp_path,
    )  # fmt: skip
    assert done.returncode == 3
    for words in ("diverged at t = ", "element", "between nodes", "stretch", "solver.step"):
        assert words in done.stderr
    result = exunet.load_result(tmp_path / "here/result.h5")
    assert not result.complete
    assert result.verdict.startswith("diverged")
    assert 0 < result.time[-1] < 0.6  # the strings snap at 0.57 s
    assert json.loads((tmp_path / "here/summary.json").read_text())["verdict"] == result.verdict
    names = [line.split("  ")[0] for line in done.stdout.splitlines()]
    assert names.index("stored states") < names.index("energy balance") < names.index("largest tension")


@pytest.mark.slow
def test_a_tolerance_that_cannot_be_met_ends(tmp_path):
    case = CASES / "verification" / "hanging.toml"  # at rest: no speed says what is below round-off
    done = command("run", case, "--set", "solver.tolerance=1e-30", "--out", "here", folder=tmp_path)
    assert done.returncode == 3
    assert "steps collapsed" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
def test_ctrl_c_keeps_the_part_done(tmp_path):
    """Pressed in the middle of the run: once some of it can be read."""
    arguments = ["run", PLANAR, "--set", "time.end=1000", "--set", "time.output_step=0.05", "--out", "here"]
    running = process(*arguments, folder=tmp_path, program=WRITING_OFTEN)
    wait_until(lambda: states_stored(tmp_path / "here") > 2, running)
    running.send_signal(signal.SIGINT)
    done = ended(running)
    assert done.returncode == 130
    assert "interrupted after t = " in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "here/unfinished").exists()
    result = exunet.load_result(tmp_path / "here/result.h5")
    assert not result.complete
    assert result.verdict.startswith("interrupted")
    assert len(result.time) > 2


@pytest.mark.slow
@pytest.mark.parametrize("module", ["typer", "h5py", "exudyn"])
def test_ctrl_c_at_start_up_is_clean_and_leaves_no_folder(tmp_path, module):
    """Ctrl-C while the command, or what it needs, is being imported."""
    (tmp_path / f"{module}.py").write_text("raise KeyboardInterrupt")
    arguments = ["run", PLANAR, *SHORT, "--check", "--out", "results/here"]
    done = ended(process(*arguments, folder=tmp_path))  # whose modules come first
    assert done.returncode in (130, -signal.SIGINT)
    assert done.stderr.splitlines()[-1] == "interrupted"
    assert "Traceback" not in done.stderr
    assert {path.name for path in tmp_path.iterdir()} <= {f"{module}.py", "__pycache__"}


@pytest.mark.ci
@pytest.mark.slow
def test_a_case_beyond_the_reference_keeps_the_result(tmp_path):
    """What the reference does not know is named before the run; the engine's own result is kept."""
    from exunet.verification import reference_run as crosscheck

    case = exunet.load(PLANAR, [SHORT[1], SHORT[3]])
    strange = tmp_path / "strange.toml"
    strange.write_text(text := PLANAR.read_text() + "\n[effects.warp]\nspeed = 9.0\n")
    other = dataclasses.replace(case, path=strange, text=text)
    with crosscheck.ReferenceRun(other) as reference:
        assert "does not know effects.warp" in reference.refusal()
        with pytest.raises(exunet.InputError, match="warp"):
            reference.agreement(exunet.run(case))


STAND_IN = """
class Refused(Exception): pass
def parse_override(text): return text, None
def read(path, overrides): pass
def prepare(case): pass
"""


@pytest.mark.slow
def test_a_check_that_cannot_be_made_is_reported_and_keeps_the_result(tmp_path, monkeypatch):
    """A package of its name stands in for a reference that does not know the case."""
    (tmp_path / "reference_impl").mkdir()
    refusing = STAND_IN.replace("overrides): pass", "overrides): raise Refused")
    (tmp_path / "reference_impl" / "__init__.py").write_text(refusing)
    words = "import sys\n\nsys.exit('reference_impl does not know warp')\n"
    (tmp_path / "reference_impl" / "__main__.py").write_text(words)
    monkeypatch.setattr("exunet.verification.reference_run._home", lambda: str(tmp_path))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    done = command("run", PLANAR, "--check", *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 4, done.stdout + done.stderr
    assert "will not be checked: " in done.stderr
    assert "does not know warp" in done.stderr
    assert "none: the reference cannot check" in done.stdout
    assert "warp" in json.loads((tmp_path / "here/summary.json").read_text())["check"]["refused"]
    assert exunet.load_result(tmp_path / "here/result.h5").complete


@pytest.mark.slow
def test_a_check_covers_bodies(tmp_path):
    """A launch with a chaser, and a rigid body beside the net."""
    case = PLANAR.parent / "verification" / "trajectories" / "launch_spring.toml"
    done = command("run", case, "--check", "--out", "here", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "body debris" in " ".join(done.stdout.split())
    check = json.loads((tmp_path / "here/summary.json").read_text())["check"]
    assert check["agrees_until_s"] is None
    # The first steps of the body's rotation are those of the net, so its errors are far below these.
    assert check["bodies"]["debris"]["attitude_rad"] < 1e-6
    assert check["bodies"]["chaser"]["position_m"] < 1e-6


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
def test_ctrl_c_while_the_reference_runs_keeps_the_result(tmp_path):
    """Pressed when the result is written; a package of its name stands in for a slow reference."""
    (tmp_path / "reference_impl").mkdir()
    (tmp_path / "reference_impl" / "__init__.py").write_text(STAND_IN)
    (tmp_path / "reference_impl" / "__main__.py").write_text("import time\n\ntime.sleep(3600)\n")
    running = process("run", PLANAR, "--check", "--out", "here", *SHORT, folder=tmp_path)
    result = tmp_path / "here/result.h5"
    wait_until(lambda: result.exists() and exunet.load_result(result).complete, running)
    running.send_signal(signal.SIGINT)
    done = ended(running)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    assert exunet.load_result(result).complete


@pytest.mark.slow
def test_a_refused_run_leaves_an_earlier_result_alone(tmp_path):
    command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    before = {name: (tmp_path / name).read_bytes() for name in written(tmp_path)}
    for arguments in (["--set", "net.bullets.mass=1e308"], ["--set", "launch.radial_speed=1e200"]):
        done = command("run", PLANAR, *SHORT, "--out", "here", *arguments, folder=tmp_path)
        assert done.returncode == 2, done.stdout + done.stderr
        assert "floating-point" in done.stderr
    assert {name: (tmp_path / name).read_bytes() for name in written(tmp_path)} == before


def test_the_command_alone_prints_its_help_line_by_line(tmp_path):
    done, asked = command(folder=tmp_path), command("-h", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr == asked.stdout
    assert done.stderr.count("\n") > 12


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", PLANAR, "--checkpoint-every", "abc"), "--checkpoint-every"),
        (("ensemble", PLANAR, "-n", "many"), "--runs"),
        (("cost", PLANAR, "--budget", "-1"), "--budget"),
        (("run", PLANAR, "--spread", "3"), "--spread"),
        (("run", PLANAR, "--nope"), "--nope"),
        (("plot", PLANAR, "--format"), "--format"),
        (("run", PLANAR, "--check=1"), "--check"),
        (("run", PLANAR, "more"), "more"),
        (("compare", "a"), "B"),
        (("rum",), "rum"),
    ],
)
def test_a_wrong_option_is_named(tmp_path, arguments, words):
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr.splitlines()[-1]
    assert written(tmp_path) == set()


def test_a_file_that_the_system_refuses_is_not_taken_for_the_terminal(tmp_path, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        Path(tmp_path).read_bytes()

    monkeypatch.setattr("exunet.cli.check.describe", refuse)
    done = command("check", PLANAR, folder=tmp_path)
    assert (done.returncode, done.stderr) == (2, f"{tmp_path}: Is a directory\n")


@pytest.mark.ci_for("arguments0")
@pytest.mark.slow_for("arguments0", "arguments2")
@pytest.mark.parametrize("arguments", [("schema",), ("-h",), ("check", PLANAR)])
def test_a_pipe_that_closes_early_ends_a_command_quietly(tmp_path, arguments):
    """As `| head` does; 128 and the number of SIGPIPE, as of any program."""
    running = process(*arguments, folder=tmp_path)
    assert running.stdout is not None
    assert running.stderr is not None
    running.stdout.close()
    words = running.stderr.read()
    assert (running.wait(), [line for line in words.splitlines() if "compil" not in line]) == (141, [])
    running.stderr.close()


@pytest.mark.slow
def test_a_run_goes_on_when_nobody_reads_what_it_tells(tmp_path):
    class Closed(StringIO):
        def write(self, _text: str) -> int:
            raise BrokenPipeError

    arguments = ["exunet", "run", str(PLANAR), *SHORT, "--spread", "0", "--out", str(tmp_path / "here")]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()), redirect_stderr(Closed()):
        patch.setattr(sys, "argv", arguments)
        with pytest.raises(SystemExit) as end:
            main()
    assert not end.value.code
    assert exunet.load_result(tmp_path / "here").complete


def test_a_library_that_fails_to_load_for_ctrl_c_is_an_interruption(monkeypatch, capsys):
    """Compiled modules raise "ImportError: initialization failed" from it: a traceback, and exit code 1."""

    def cut(*_: object, **__: object) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error

    monkeypatch.setattr("exunet.cli.main.app", cut)
    monkeypatch.setattr(sys, "argv", ["exunet", "check", str(PLANAR)])
    with pytest.raises(SystemExit) as end:
        main()
    assert (end.value.code, capsys.readouterr().err) == (130, "interrupted\n")


def test_a_library_that_is_missing_stays_a_defect(monkeypatch):
    def absent(*_: object, **__: object) -> None:
        raise ImportError("no module")

    monkeypatch.setattr("exunet.cli.main.app", absent)
    with pytest.raises(ImportError, match="no module"):
        main()


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_h_is_short_for_help(tmp_path, name):
    arguments = [name] if name else []
    short, long = (command(*arguments, option, folder=tmp_path) for option in ("-h", "--help"))
    assert short.returncode == long.returncode == 0
    assert short.stdout == long.stdout
    assert "Usage: exunet" in short.stdout


def test_help_has_the_units(tmp_path):
    for name, words in (("ensemble", "[m]"), ("cost", "runs [s]"), ("plot", "figure [mm]")):
        assert words in " ".join(command(name, "-h", folder=tmp_path).stdout.split())


def test_the_version(tmp_path):
    done = command("--version", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"exunet {VERSION}\n", "")


@pytest.mark.slow
def test_a_quiet_run_prints_errors_only(tmp_path):
    done = command("run", PLANAR, *SHORT, "--quiet", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list(tmp_path.rglob("result.h5"))) == 1
    done = command("run", PLANAR, *SHORT, "--quiet", "--set", "net.mesh=0.7", folder=tmp_path)
    assert done.returncode == 2
    assert "net.mesh" in done.stderr
