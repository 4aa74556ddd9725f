# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Shows a robot that you drive in the browser, and trains one of your own meanwhile.

At once a page opens on which a quadruped is driven by keys, a stick and pushes; its policy comes
with vgps_ros. Meanwhile this machine trains another one in a few minutes, tries it, and opens the
page of that one. Each step is a command of vgps that you could type yourself, and is shown. A page
is one file without a server behind it: copy it anywhere.
"""

import argparse
import os
import shlex
import sys
import webbrowser
from pathlib import Path

from vgps_ros.core.seeding import SEED
from vgps_ros.programs.command_line import Parser, refuse_existing
from vgps_ros.storage.run_folder import RunFolder

_SHIPPED = Path(__file__).parents[1] / "tasks" / "quadruped" / "policy.json"
_ITERATIONS = "12"  # of 22; each seed that was tried (0, 5, 6) obeyed all commands by then


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_output("--output", "folder for the pages and the run", default=Path("vgps-demo"))
    parser.add_settings(SEED)
    parser.add_argument(
        "--no-browser", action="store_true", help="write the pages, but open none of them"
    )
    parser.set_defaults(interrupted="interrupted; the same command goes on where it was.")


def run(arguments: argparse.Namespace) -> None:
    """Runs the commands of the demonstration one after another."""
    folder: Path = arguments.output
    shipped, trained, run_folder = folder / "shipped", folder / "trained", folder / "run"
    overwrite = ["--overwrite"] if arguments.overwrite else []
    refuse_existing([trained], overwrite=arguments.overwrite)

    print("1. A policy that comes with vgps_ros. Drive it while yours is trained.", flush=True)
    if arguments.overwrite or not (shipped / "index.html").exists():
        _run_command("export", _SHIPPED, "--web", shipped, *overwrite)
    _open(shipped / "index.html", arguments.no_browser)

    print("\n2. A policy of your own, trained on this machine.", flush=True)
    if arguments.overwrite or not RunFolder(run_folder).is_finished():
        training = ("--seed", arguments.seed, "--iterations", _ITERATIONS, "--output", run_folder)
        _run_command("train", "--task", "quadruped", *training, *overwrite)

    print("\n3. How well it obeys.", flush=True)
    _run_command("evaluate", run_folder, "--seconds", "6", "--rollouts", "4", "--pushes", "20")

    print("\n4. Its page, and its ONNX file.", flush=True)
    _run_command("export", run_folder, "--web", trained, *overwrite)
    _open(trained / "index.html", arguments.no_browser)


def _run_command(*words: object) -> None:
    """Runs a command of vgps in this process, after showing it."""
    from vgps_ros.programs.__main__ import run_command

    texts = [*map(str, words)]
    print(f"$ vgps {shlex.join(texts)}", flush=True)
    run_command(texts)


def _open(page: Path, no_browser: bool) -> None:
    """Opens a page in the user's browser, or says where it is."""
    print(f"Open {page} in a browser: no server is needed.", flush=True)
    # Without a screen, webbrowser would start a browser of text in this terminal.
    has_screen = sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()
    if has_screen and not no_browser:
        webbrowser.open(page.resolve().as_uri())
