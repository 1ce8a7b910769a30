"""Wall times a newcomer sees: importing exunet, the planar deployment's integration, and the whole command.

    python benchmarks/deployment.py [--repeats 7]

Writes benchmarks/deployment.md: medians and spread (smallest to largest) of the repeats, which take turns.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
CASE = HERE.parent / "cases" / "planar_deployment.toml"


def timed(*command: str) -> float:
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    found: dict[str, list[float]] = {}
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            run = (sys.executable, "-m", "exunet", "run", str(CASE), "--out", folder)
            found.setdefault("`exunet run` whole, figures included", []).append(timed(*run))
            engine = json.loads((Path(folder) / "summary.json").read_text())["engine"]
            found.setdefault("its build of the model", []).append(engine["build_seconds"])
            found.setdefault("its integration", []).append(engine["integration_seconds"])
            found.setdefault("`exunet run --check` whole", []).append(timed(*run, "--check"))
        found.setdefault("`import exunet`", []).append(timed(sys.executable, "-c", "import exunet"))
        used = "import exunet; exunet.load, exunet.run, exunet.Result, exunet.deployment"
        found.setdefault("`import exunet` and every name of it used", []).append(
            timed(sys.executable, "-c", used)
        )
    lines = [
        "# Wall times of the planar deployment",
        "",
        f"`python benchmarks/deployment.py --repeats {repeats}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "",
        "| | median [s] | smallest to largest [s] |",
        "|---|---|---|",
    ]
    for name, values in found.items():
        lines.append(f"| {name} | {statistics.median(values):.2f} | {min(values):.2f} to {max(values):.2f} |")
    text = "\n".join(lines) + "\n"
    (HERE / "deployment.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
