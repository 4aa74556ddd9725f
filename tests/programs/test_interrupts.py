# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""INT and TERM end a program with one sentence and code 1."""

import signal
import subprocess
import sys

import pytest

_PROGRAM = """
import time
from vgps_ros.programs import __main__, check

def run(_):
    try:
        print("works", flush=True)
        time.sleep(60)
    finally:
        print("cleans up", flush=True)

check.run = run
__main__.main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("prefix", [[], ["env", "--ignore-signal"]])  # as a script's shell does
def test_a_signal_ends_a_program_with_one_sentence(number, prefix):
    program = subprocess.Popen(
        [*prefix, sys.executable, "-c", _PROGRAM, "check", "rotor"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert program.stdout.readline() == "works\n"
    program.send_signal(number)
    output, errors = program.communicate(timeout=60)
    assert program.returncode == 1
    assert (output, errors) == ("cleans up\n", "vgps check: interrupted.\n")
