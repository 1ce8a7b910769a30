"""What the README shows, done."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def test_python_example_runs(tmp_path, monkeypatch, capsys):
    (code,) = blocks("python")
    assert len([line for line in code.splitlines() if line]) <= 11
    (tmp_path / "cases").symlink_to(ROOT / "cases")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    shown = capsys.readouterr().out
    assert "2.261" in shown  # m/s at 1 s, damped: reference_impl/README.md
    assert (tmp_path / "deployment.h5").exists()
    assert len(list((tmp_path / "figures").glob("*.png"))) == 5


def test_picture_and_links_exist():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_first_blocks_are_the_newcomers_commands():
    first, second, *_ = blocks("sh")
    assert "exunet run cases/planar_deployment.toml --check" in first
    assert "pytest" in second
