"""The command as its user meets it: exit codes, files, and the key or option that an error names."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from commands import CASES, PLANAR, SHORT, command, content, process
from result_samples import square_net, unfolding

import exunet
from exunet.base.version import VERSION
from exunet.cli.main import main
from exunet.simulation import recorder

# Nothing is taut within 0.02 s: no figure of tensions.
FIGURES = {"snapshots.png", "area.png"}
DIVERGES = ("--set", "solver={method='RK44', step=2.5e-2, force=true}", "--set", "time.output_step=0.1")


# What is written and printed


@pytest.mark.slow
def test_run_writes_result_summary_and_figures_only(tmp_path):
    done = command("run", PLANAR, *SHORT, "--ensemble", 8, folder=tmp_path, figures=("snapshots", "area"))
    assert done.returncode == 0, done.stderr
    folder = "results/planar_deployment--time.end=0.02--time.output_step=0.01"
    names = {"report.html", "result.h5", "summary.json", "ensemble.h5"} | FIGURES
    assert set(content(tmp_path)) == {f"{folder}/{name}" for name in names}
    summary = json.loads((tmp_path / folder / "summary.json").read_text())
    result = exunet.load_result(tmp_path / folder)
    assert summary["verdict"] == result.verdict == "ok"
    assert summary["mass_kg"] == pytest.approx(result.net.mass.sum(), rel=1e-12)
    assert result.run.case.text == PLANAR.read_text()
    assert result.run.case.overrides == [SHORT[1], SHORT[3]]


@pytest.mark.slow
def test_a_run_prints_fifteen_lines_and_show_prints_them_again(tmp_path):
    """All metrics with --all; a summary that is cut short, and a folder without a result, are errors."""
    done = command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    assert len(done.stdout.splitlines()) <= 15
    assert command("show", "here", folder=tmp_path).stdout == done.stdout
    every = command("show", "here/result.h5", "--all", folder=tmp_path).stdout
    summary = json.loads((tmp_path / "here/summary.json").read_text())
    assert all(item["words"] in every for item in summary["metrics"].values())
    (tmp_path / "here/summary.json").write_text('{"title": "cut"}')
    for path in ("here", "nowhere"):
        refused = command("show", path, folder=tmp_path)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)


@pytest.mark.slow
def test_plot_draws_the_figures_again(tmp_path):
    command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path, figures=("snapshots", "area"))
    assert (
        command(
            "plot", "here/result.h5", "--out", "again", folder=tmp_path, figures=("snapshots", "area")
        ).returncode
        == 0
    )
    for name in FIGURES:
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


@pytest.mark.ci
@pytest.mark.slow
def test_check_prints_what_would_be_simulated_and_writes_nothing(tmp_path):
    done = command("check", PLANAR, "--all", folder=tmp_path)
    assert done.returncode == 0
    printed = " ".join(done.stdout.split())  # long rows are folded
    for item in ("40, 64", "2.360819 kg", "rayleigh_damping", "DOPRI5", "64 ObjectConnectorSpringDamper",
                 "40 MassPoint", "1 ObjectGenericODE2"):  # fmt: skip
        assert item in printed
    undamped = command("check", CASES / "planar_undamped.toml", "--all", folder=tmp_path)
    assert "ObjectGenericODE2" not in undamped.stdout  # no damping object where there is no damping
    body = "bodies.target={mass=7.0,inertia=[2.0,3.0,4.0],angular_velocity=[0.0,0.0,0.1]}"
    launched = CASES / "effects" / "launch_force.toml"
    done = command(
        "check", launched, "--all", "--set", body, "--set", "engine.backend=compiled", folder=tmp_path
    )
    printed = " ".join(done.stdout.split())
    for item in ("7 kg, free", "2, 3, 4 kg m2", "(0, 0, 0.1) rad/s"):
        assert item in printed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_quiet_run_prints_errors_only(tmp_path):
    done = command("run", PLANAR, *SHORT, "--quiet", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list(tmp_path.rglob("result.h5"))) == 1


def test_help_and_version(tmp_path):
    alone, short, long = (command(*given, folder=tmp_path) for given in ((), ("-h",), ("run", "--help")))
    assert [alone.returncode, short.returncode, long.returncode] == [2, 0, 0]
    assert alone.stderr == short.stdout
    assert long.stdout.startswith("Usage: exunet run")
    done = command("--version", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"exunet {VERSION}\n", "")


def test_help_waits_for_no_numerical_library():
    """NumPy, SciPy and Pydantic take several times as long to import as the help to print."""
    code = "import sys, exunet.cli.main; print({'numpy', 'scipy', 'pydantic'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


# The check by the reference


@pytest.mark.slow
def test_check_adds_the_reference(tmp_path):
    done = command("run", PLANAR, "--check", *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    check = json.loads((tmp_path / "here/summary.json").read_text())["check"]
    assert check["agrees_until_s"] is None
    assert 0 <= check["speed_difference"]["largest_m_s"] < 1e-12  # free flight: round-off only
    assert (tmp_path / "here/agreement.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_check_covers_bodies(tmp_path):
    """A launch with a chaser, and a rigid body beside the net."""
    case = CASES / "verification" / "trajectories" / "launch_spring.toml"
    done = command("run", case, "--check", "--out", "here", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    check = json.loads((tmp_path / "here/summary.json").read_text())["check"]
    assert check["agrees_until_s"] is None
    # The first steps of the body's rotation are those of the net, so its errors are far below these.
    assert check["bodies"]["debris"]["attitude_rad"] < 1e-6
    assert check["bodies"]["chaser"]["position_m"] < 1e-6


@pytest.mark.slow
def test_a_case_beyond_the_reference_is_refused_by_it(tmp_path):
    from exunet.verification import reference_run as crosscheck

    case = exunet.load(PLANAR, SHORT[1::2])
    strange = tmp_path / "strange.toml"
    strange.write_text(text := PLANAR.read_text() + "\n[effects.warp]\nspeed = 9.0\n")
    with crosscheck.ReferenceRun(dataclasses.replace(case, path=strange, text=text)) as reference:
        assert "effects.warp" in reference.refusal()
        with pytest.raises(exunet.InputError, match="warp"):
            reference.agreement(exunet.run(case))


@pytest.mark.slow
def test_a_check_that_cannot_be_made_is_reported_and_keeps_the_result(tmp_path, monkeypatch):
    """A package of its name stands in for a reference that does not know the case."""
    package = tmp_path / "reference_impl"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text("import sys\n\nsys.exit('reference_impl does not know warp')\n")
    monkeypatch.setattr("exunet.verification.reference_run._home", lambda: str(tmp_path))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    done = command("run", PLANAR, "--check", *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 4, done.stdout + done.stderr
    assert "does not know warp" in done.stderr
    assert "warp" in json.loads((tmp_path / "here/summary.json").read_text())["check"]["refused"]
    assert exunet.load_result(tmp_path / "here/result.h5").complete


# Wrong input: exit code 2, one line that names the key or option, and nothing is written


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["run", "absent.toml"], "absent.toml: "),
        (["run", ""], "the name of a file or folder is empty"),
        (["run", PLANAR, "--out", ""], "the name of a file or folder is empty"),
        (["run", PLANAR, "--out", PLANAR], "planar_deployment.toml: cannot be written"),
        (["run", PLANAR, "--out", "/proc/no"], "/proc/no: cannot be written"),
        (["plot", PLANAR], "planar_deployment.toml: "),
        (["plot", "absent.h5"], "absent.h5: "),
        (["schema", "--json", "--template"], "--json, --template: "),
        (["run", PLANAR, *SHORT, "--checkpoint-every", 0], "--checkpoint-every: "),
        (["run", PLANAR, "--checkpoint-every", "abc"], "--checkpoint-every"),
        (["run", PLANAR, *SHORT, "--ensemble", 3], "--ensemble"),
        (["ensemble", PLANAR, *SHORT, "-n", 0], "--runs: "),
        (["ensemble", PLANAR, *SHORT, "--perturb", 10], "0.55 m or less"),
        (["ensemble", PLANAR, *SHORT, "--seed", -1], "--seed: "),
        (["effects", PLANAR, "--accuracy", "nan"], "--accuracy"),
        (["effects", PLANAR, "--accuracy", -1], "--accuracy"),
        (["cost", PLANAR, "--budget", -1], "--budget"),
        (["cost", PLANAR, "--runs", 0], "--runs"),
        (["verify", PLANAR, "--processes", 0], "--processes"),
        (["fmu", PLANAR, "--fmi", 4], "--fmi: "),
        (["animate", ".", "--fps", 0], "--fps: "),
        (["run", PLANAR, "--nope"], "--nope"),
        (["run", PLANAR, "--check=1"], "--check"),
        (["compare", "a"], "B"),
        (["rum"], "rum"),
    ],
)
def test_wrong_input_is_named_and_nothing_is_written(tmp_path, arguments, named):
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 2, done.stdout + done.stderr
    assert named in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("animate", "result.h5", "--from", 2.0), "--from, --until: "),
        (("plot", "result.h5", "--format", "gif"), "--format: "),
        (("plot", "result.h5", "--width", 3), "--width: "),
        (("plot", "result.h5", "--figure", "speeds"), "--figure: "),
    ],
)
def test_the_option_is_named_and_not_the_argument_of_the_function(tmp_path, arguments, named):
    exunet.save(unfolding(square_net()), tmp_path / "result.h5")
    done = command(*arguments, folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(named)
    assert set(content(tmp_path)) == {"result.h5"}


def test_a_page_has_a_name_of_its_own(tmp_path):
    exunet.save(unfolding(square_net()), tmp_path / "result.h5")
    assert command("view", "result.h5", "-o", "page.html", folder=tmp_path).returncode == 0
    assert set(content(tmp_path)) == {"result.h5", "page.html"}


@pytest.mark.parametrize(
    ("case", "override", "key", "value"),
    [
        ("planar_deployment.toml", "net.mesh=0.7", "net.mesh", ""),
        ("planar_deployment.toml", "net.cable.diametr=1", "net.cable.diametr", "diameter"),
        ("planar_deployment.toml", "solver.method=RK4", "solver.method", "RK44"),
        ("planar_deployment.toml", "time.end=1e18", "time.end", "10,000,000"),
        ("planar_deployment.toml", "time.output_step=1e-12", "time.output_step", "2e+12"),
        # Round-off of speeds of 2.5 m/s: 2.5 * 2^-52 = 6e-16 m/s.
        ("planar_deployment.toml", "solver.tolerance=1e-20", "solver.tolerance", "6e-16 m/s"),
        ("planar_deployment.toml", "solver={method='RK44', step=2.5e-2}", "solver.step", "0.0002548 s"),
        ("planar_deployment.toml", "bodies.cat={mass=1.0,shape='mesh',file='absent.stl',unit='m'}",
         "bodies.cat.file", "absent.stl"),
        ("nets/accordion.toml", "initial.packing=0.5", "initial.packing", ""),
        ("bodies/tow.toml", "tethers.tow.divisions=1000000000", "tethers.tow.divisions", "1,000,000"),
        ("bodies/tow.toml", "bodies.chaser.position=[1e300,0.0,0.0]", "bodies.chaser.position[0]", ""),
        ("bodies/frame.toml", "bodies.frame.position=[0.0,1e300,0.0]", "bodies.frame.position[1]", ""),
        ("bodies/ejection.toml", "bodies.chaser.position=[1e20,0.0,0.0]", "bodies.chaser.position", "1e+20"),
    ],
)  # fmt: skip
def test_the_key_that_was_changed_is_named_once(tmp_path, case, override, key, value):
    """The stable step of RK44 is that of the tests of stability."""
    done = command("check", CASES / case, "--set", override, folder=tmp_path)
    assert done.returncode == 2
    (error,) = (line for line in done.stderr.splitlines() if not line.startswith("warning: "))
    assert re.match(rf"--set .*: {re.escape(key)}: ", error)
    assert value in error


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("youngs_modulus = 70e9", "youngs_modulus = 1e308", "net.cable.youngs_modulus"),
        ("density = 1390.0", "density = 1e308", "net.cable.density"),
        ("mass = 0.5", "mass = 1e308", "net.bullets.mass"),
        ("radial_speed = 2.5", "radial_speed = 1e200", "launch.radial_speed"),
        ("packing = 0.1", "packing = 1e300", "initial.packing"),
        ('method = "DOPRI5"', 'method = "RK44"\nstep = 0.0255', "solver.step"),
    ],
)
def test_errors_of_preparing_a_run_have_their_line(tmp_path, old, new, key):
    text = PLANAR.read_text().replace(old, new, 1)
    (tmp_path / "bad.toml").write_text(text)
    last = new.splitlines()[-1]
    number = next(n for n, line in enumerate(text.splitlines(), 1) if line.startswith(last))
    for name in ("run", "check"):
        done = command(name, "bad.toml", folder=tmp_path)
        assert done.returncode == 2, done.stdout + done.stderr
        assert done.stderr.startswith(f"bad.toml:{number}: {key}: ")
        assert done.stderr.count("\n") == 1
    assert set(content(tmp_path)) == {"bad.toml"}


def test_all_errors_are_reported_at_once(tmp_path):
    text = PLANAR.read_text().replace("mass = 0.5", "mass = -0.5").replace("end = 2.0", "end = nan")
    text = text.replace("radial_speed", "radial_sped")
    (tmp_path / "bad.toml").write_text(text)
    done = command("run", "bad.toml", folder=tmp_path)
    assert done.returncode == 2
    reported = {tuple(line.split(": ")[:2]) for line in done.stderr.splitlines()}
    lines = text.splitlines()
    for start, key in (
        ("mass = -0.5", "net.bullets.mass"),
        ("end = nan", "time.end"),
        ("radial_sped", "launch.radial_sped"),
    ):
        number = next(n for n, line in enumerate(lines, 1) if line.startswith(start))
        assert (f"bad.toml:{number}", key) in reported


def test_of_two_keys_that_contradict_each_other_the_last_is_named(tmp_path):
    text = (CASES / "nets" / "accordion.toml").read_text()
    text = text.replace("[initial.fold]", "[initial]\npacking = 0.5\n[initial.fold]")
    (tmp_path / "case.toml").write_text(text)
    done = command("check", "case.toml", folder=tmp_path)
    line = text.splitlines().index("[initial.fold]") + 1
    assert done.stderr.startswith(f"case.toml:{line}: initial.fold: ")


@pytest.mark.parametrize("name", ["run", "ensemble", "cost"])
def test_a_file_in_place_of_a_folder(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    for out in ("file", "file/more"):
        done = command(name, PLANAR, *SHORT, "--out", out, folder=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith(f"{out}: cannot be written: ")
    assert content(tmp_path) == {"file": b"mine"}


@pytest.mark.slow
def test_the_file_of_an_ensemble_is_not_taken_for_a_result(tmp_path):
    assert command("ensemble", PLANAR, *SHORT, "-n", 8, "--out", "here", folder=tmp_path).returncode == 0
    done = command("plot", "here/ensemble.h5", folder=tmp_path)
    assert done.returncode == 2
    assert "ensemble" in done.stderr


def test_perturbed_runs_beyond_the_memory_are_refused_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "memory_left", lambda: 10**9)
    done = command("run", PLANAR, *SHORT, "--ensemble", 50_000, "--out", "here", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("--ensemble: ")
    assert list(tmp_path.iterdir()) == []


# Runs that stop


@pytest.mark.slow
def test_a_forced_step_100_times_too_large_diverges_and_is_kept(tmp_path):
    done = command("run", PLANAR, *DIVERGES, "--out", "here", folder=tmp_path)
    assert done.returncode == 3
    assert "diverged at t = " in done.stderr
    result = exunet.load_result(tmp_path / "here")
    assert not result.complete
    assert result.verdict.startswith("diverged")
    assert 0 < result.time[-1] < 0.6  # the strings snap at 0.57 s
    assert " ".join(f"{done.stdout} {done.stderr}".split()).count(result.verdict.split(": ")[1]) == 1
    assert json.loads((tmp_path / "here/summary.json").read_text())["verdict"] == result.verdict


@pytest.mark.slow
def test_a_tolerance_that_cannot_be_met_ends(tmp_path):
    case = CASES / "verification" / "hanging.toml"  # at rest: no speed from which round-off is known
    done = command("run", case, "--set", "solver.tolerance=1e-30", "--out", "here", folder=tmp_path)
    assert done.returncode == 3
    assert "steps collapsed" in done.stderr


# Pipes and the system


@pytest.mark.slow_for("arguments1")
@pytest.mark.parametrize("arguments", [("-h",), ("check", PLANAR)])
def test_a_pipe_that_closes_early_ends_a_command_quietly(tmp_path, arguments):
    """As `| head` does; 128 and the number of SIGPIPE, as of any program."""
    with process(*arguments, folder=tmp_path) as running:
        running.stdout.close()
        lines = [line for line in running.stderr.read().splitlines() if "compil" not in line]
    assert (running.returncode, lines) == (141, [])


@pytest.mark.slow
def test_a_run_goes_on_when_nobody_reads_what_it_reports(tmp_path):
    class Closed(StringIO):
        def write(self, _text: str) -> int:
            raise BrokenPipeError

    arguments = ["exunet", "run", str(PLANAR), *SHORT, "--ensemble", "0", "--out", str(tmp_path / "here")]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()), redirect_stderr(Closed()):
        patch.setattr(sys, "argv", arguments)
        with pytest.raises(SystemExit) as end:
            main()
    assert not end.value.code
    assert exunet.load_result(tmp_path / "here").complete


def test_errors_from_within_a_command(tmp_path, monkeypatch):
    """A file that the system refuses is wrong input; a missing module a defect; Ctrl-C Ctrl-C."""

    def refuse(*_: object, **__: object) -> None:
        Path(tmp_path).read_bytes()

    def absent(*_: object, **__: object) -> None:
        raise ImportError("no module")

    def cut(*_: object, **__: object) -> None:  # compiled modules raise it so
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error

    monkeypatch.setattr("exunet.cli.check.describe", refuse)
    done = command("check", PLANAR, "--all", folder=tmp_path)
    assert (done.returncode, done.stderr.partition(": ")[0]) == (2, str(tmp_path))
    monkeypatch.setattr("exunet.cli.main.app", cut)
    assert command("check", PLANAR, folder=tmp_path).returncode == 130
    monkeypatch.setattr("exunet.cli.main.app", absent)
    with pytest.raises(ImportError, match="no module"):
        main()


def test_a_check_is_at_most_fifteen_lines_with_its_warnings_first(tmp_path):
    printed = command(
        "check", CASES / "missions" / "capture_satellite.toml", folder=tmp_path
    ).stdout.splitlines()
    assert len(printed) <= 15
    assert next(k for k, line in enumerate(printed) if line.startswith("!")) <= 2  # the title has two lines
    assert any("limited by" in line for line in printed)
