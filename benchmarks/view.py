"""Size and speed of pages with a 3-D view: python benchmarks/view.py

Runs captures of a box with 20 x 20 and 40 x 40 meshes, 1001 stored states each, writes their pages and opens
them in a headless Chromium, which must be installed. Writes view.md.
"""

from __future__ import annotations

import platform
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import exunet
from exunet.base.files import markdown_table
from exunet.plots.view import save_view

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))
CASE = HERE.parent / "cases" / "capture" / "box.toml"
RUNS = {
    "capture/box": (),
    "capture/box, 1001 states": ("time.output_step=0.002",),
    "40 x 40 meshes, 1001 states": ("net.mesh=0.125", "time.end=0.5", "time.output_step=0.0005"),
}
ROUNDS = 5
FRAMES = 200
# Plays a run: a picture for each frame, as while it is played.
PLAY = f"""(async () => {{
  const times = viewer.runs[0].time, length = times[times.length - 1] - times[0];
  for (let k = 0; k < {FRAMES}; k++) {{
    viewer.set(times[0] + length * k / {FRAMES});
    await new Promise(requestAnimationFrame);
  }}
}})()"""


def script(browser: Any) -> float:
    """Return the CPU that JavaScript has taken [s]."""
    metrics = browser.call("Performance.getMetrics")["metrics"]
    return float(next(item["value"] for item in metrics if item["name"] == "ScriptDuration"))


def main() -> None:
    """Measure and write the page."""
    from browser import chromium

    rows = []
    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder) / "profile") as browser:
        for name, changes in RUNS.items():
            result = exunet.run(exunet.load(CASE, list(changes)))
            path, seconds = Path(folder) / "view.html", []
            for _ in range(ROUNDS):
                start = time.process_time()
                save_view(result, path)
                seconds.append(time.process_time() - start)
            start = time.perf_counter()
            browser.open(path)
            opened = time.perf_counter() - start
            browser.call(
                "Performance.enable", timeDomain="threadTicks"
            )  # CPU, whatever else the machine does
            before = script(browser)
            browser.evaluate(PLAY)
            spent = 1e3 * (script(browser) - before) / FRAMES
            assert browser.problems == []
            sizes = f"{result.net.n_elements} x {len(result.time)}"
            size = f"{path.stat().st_size / 1e6:.2f}"
            row = [name, sizes, size, f"{statistics.median(seconds):.2f}", f"{opened:.1f}"]
            rows.append([*row, f"{spent:.2f}"])
    head = [
        "run",
        "elements x states",
        "page [MB]",
        "writing [s of CPU]",
        "opening [s]",
        "script [ms a frame]",
    ]
    words = f"""# Pages with a 3-D view

`python benchmarks/view.py` on {platform.machine()}, Python {platform.python_version()}, in a headless
Chromium without a graphics card. Writing: median of {ROUNDS} pages. Opening: from the call until the first
picture is ready. Script: CPU of all JavaScript of the page over {FRAMES} frames, which sets positions,
colours, plots and words and calls WebGL.
"""
    lines = [words, *markdown_table(head, rows)]
    (HERE / "view.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
