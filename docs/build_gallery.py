"""Writes the gallery into docs/gallery: python docs/build_gallery.py [--quick]

Each case runs once, two at a time. Its picture, 3-D page and card stay in docs/_build/gallery until the case
or the package changes. The card of a case that fails or takes over a minute states so.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import exunet
from exunet.base.cases import CASES
from exunet.plots.nets import line_width
from exunet.plots.scene_3d import draw, prepare, scene_3d
from exunet.plots.view import write_page
from exunet.results.observables import Observables
from exunet.results.summary import summary_of
from exunet.results.table import GAP, report
from exunet.scene.casefile import implausible

DOCS = Path(__file__).resolve().parent
PAGES, STORE = DOCS / "gallery", DOCS / "_build" / "gallery"
VIEWER = Path(exunet.__file__).parent / "plots" / "viewer"
LIMIT = 60.0  # s of processor time of a case
FRAMES, LARGEST = 150, 1_200_000  # stored states and bytes of a 3-D page
SECTIONS = {  # to folders, with the cases that look or end differently
    "Deployment in a plane": ("", "planar_deployment planar_undamped"),
    "Nets": ("nets/", "accordion cords cut own star"),
    "Effects": ("effects/", "air_drag launch_force orbit thermal_strain"),
    "Bodies and tethers": ("bodies/", "ejection frame launch release snap tow"),
    "Captures": ("capture/", "box cubesat cylinder free_sphere l_shape miss rocket satellite"),
    "Missions": (
        "missions/",
        "capture_satellite closed_box cut_tether drift drift_controlled missed open_box throw_10m "
        "throw_close_tow",
    ),
    "Hard cases": ("hard/", "all_in_one_point closing_bodies over_an_edge spinning winding_up"),
    "A known answer": ("verification/", "closing/loop"),
}
CHOSEN = {title: [f"{folder}{name}" for name in names.split()] for title, (folder, names) in SECTIONS.items()}
QUICK = (
    "nets/accordion",
    "effects/orbit",
    "bodies/tow",
    "capture/box",
    "missions/throw_close_tow",
    "hard/winding_up",
)
HEAD = """# Gallery

Each picture shows a run of a shipped case at the last contact, else at the largest area of the mouth, else at
the largest tension. Threads are blue, contacts red, bullets and closing lines black. A card opens the run in
3-D, its case and its command. `exunet cases` lists all shipped cases.
"""
CARD = """:::{{grid-item-card}}
{image}:link: {name}
:link-type: doc
:class-card: run

**{title}**

{outcome}

{time}
:::"""
PAGE = """---
nosearch: true
---
# {title}

{outcome}

{view}```sh
exunet run {name} --ensemble 0
```

```{{literalinclude}} ../../{up}cases/{name}.toml
:language: toml
:caption: cases/{name}.toml
```
"""
VIEW = """```{{raw}} html
<iframe class="view" src="../{up}views/{name}.html" title="{name} in 3-D" loading="lazy"></iframe>
<p><a href="../{up}views/{name}.html">In a window of its own</a></p>
```

"""
Card = dict[str, str]


def escaped(text: str) -> str:
    """Return Markdown that shows a text as it is, in one line."""
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", " ".join(text.split()))


def time_shown(run: Observables) -> int:
    """Return the stored time of the last contact, else of the largest area, else of the largest tension."""
    forces = [run.contact(key) for key in run.result.contacts if key.quantity == "force"]
    if forces and (touching := np.any(np.column_stack(forces) > 0.0, axis=1)).any():
        return int(np.flatnonzero(touching)[-1])
    return int((run.area if run.achievable_area else run.tension).argmax())


def draw_picture(run: Observables, path: Path) -> None:
    """Draw the scene at the time that shows it best."""
    k, figure = time_shown(run), Figure(figsize=(4.0, 3.0), dpi=160)
    axes, scene = figure.add_axes((0.02, 0.02, 0.96, 0.96)), scene_3d(run.result, [k])
    prepare(axes, scene)
    draw(axes, scene, k, width=1.6 * line_width(run.result.net))
    figure.savefig(path, transparent=True)


def run_case(file: Path, picture: Path, view: Path, limit: float) -> Card:
    """Run a case as `exunet run --ensemble 0` does; write its picture and its 3-D page, return its card.

    limit : processor time after which the process is ended [s]
    """
    case = exunet.load(file)
    exunet.Simulation(case).advance(case.scene.time.output_step)  # compiles, which does not count
    begin = time.process_time()
    resource.setrlimit(resource.RLIMIT_CPU, (int(begin + limit), resource.RLIM_INFINITY))
    run = Observables(exunet.run(case))
    spent = time.process_time() - begin
    summary = summary_of(run, None, None)
    summary["implausible"] = [str(fault) for fault in implausible(case)]
    rows = report(summary, case.text)
    frames = FRAMES
    write_page(view, [run], rows, frames)
    while view.stat().st_size > LARGEST:
        frames = frames * 3 // 4
        write_page(view, [run], rows, frames)
    draw_picture(run, picture)
    known = [row for row in (*rows.answer, *rows.table) if row[0] != "Timeline"]
    return {
        "title": summary["title"],
        "outcome": f"{known[0][0]}: {known[0][1].split(GAP)[0]}",
        "time": f"{summary['simulated_until_s']:.4g} s simulated in {spent:.2g} s of processor time",
    }


def sources() -> str:
    """Return a hash of the package, of this file, and of the files that cases name."""
    files = [file for file in CASES.rglob("*") if file.is_file() and file.suffix != ".toml"]
    files += [*Path(exunet.__file__).parent.rglob("*.py"), *VIEWER.glob("*.*"), Path(__file__)]
    return hashlib.sha256(b"".join(file.read_bytes() for file in sorted(files))).hexdigest()


def card_of(name: str, file: Path, store: Path, version: str) -> Card:
    """Return the card of a case that is kept, or run the case in a process of its own."""
    kept, picture, view = store / f"{name}.json", store / f"{name}.png", store / f"site/views/{name}.html"
    key = hashlib.sha256(version.encode() + file.read_bytes()).hexdigest()
    if kept.exists() and (card := json.loads(kept.read_text(encoding="utf-8")))["key"] == key:
        return dict(card)
    for path in (kept, picture, view):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
    command = [sys.executable, __file__, "--run", *map(str, (file, picture, view, LIMIT))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == -signal.SIGXCPU:
        return {"title": name, "outcome": f"stopped: it takes over {LIMIT:g} s of processor time"}
    if done.returncode:
        return {"title": name, "outcome": f"failed: {(done.stderr or 'ended').strip().splitlines()[-1]}"}
    card = {"key": key, **json.loads(done.stdout.splitlines()[-1])}
    kept.write_text(json.dumps(card), encoding="utf-8")
    return card


def write_pages(cards: Mapping[str, Card], folder: Path) -> None:
    """Write the index with the cards, and a page for each case."""
    shutil.rmtree(folder, ignore_errors=True)
    index = [HEAD]
    for section, cases in CHOSEN.items():
        shown = [name for name in cases if name in cards]
        index += [f"## {section}\n\n::::{{grid}} 1 2 3 3\n:gutter: 3\n:class-container: runs\n"] * bool(shown)
        for name in shown:
            card, up = cards[name], "../" * name.count("/")
            title, outcome = escaped(card["title"]), escaped(card["outcome"])
            image = f":img-top: /_build/gallery/{name}.png\n:img-alt: {name}\n" if "time" in card else ""
            texts = {"name": name, "title": title, "outcome": outcome, "time": card.get("time", "")}
            index.append(CARD.format(image=image, **texts))
            view = VIEW.format(up=up, name=name) if image else ""
            page = PAGE.format(title=title, outcome=outcome, view=view, name=name, up=up)
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / f"{name}.md").write_text(page, encoding="utf-8")
        index += ["::::\n"] * bool(shown)
    entries = "\n".join(f"{name} <{name}>" for name in cards)
    index.append(f"```{{toctree}}\n:hidden:\n{entries}\n```\n")
    (folder / "index.md").write_text("\n".join(index), encoding="utf-8")


def main() -> None:
    """Run what is not kept, and write all pages."""
    parser = argparse.ArgumentParser(description="Write the gallery into docs/gallery.")
    parser.add_argument("--quick", action="store_true", help="six cases")
    parser.add_argument("--run", nargs=4, metavar=("CASE", "PNG", "HTML", "SECONDS"), help="this case alone")
    arguments = parser.parse_args()
    if arguments.run:
        os.nice(10)
        *files, limit = arguments.run
        try:
            sys.stdout.write(json.dumps(run_case(*map(Path, files), float(limit))))
        except exunet.ExunetError as error:
            sys.exit(str(error))
        return
    names = [name for cases in CHOSEN.values() for name in cases if not arguments.quick or name in QUICK]
    version = sources()
    with ThreadPoolExecutor(2) as pool:
        cards = pool.map(lambda name: card_of(name, CASES / f"{name}.toml", STORE, version), names)
        write_pages(dict(zip(names, cards, strict=True)), PAGES)


if __name__ == "__main__":
    main()
