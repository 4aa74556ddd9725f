# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""MuJoCo's warnings: counted by kind for each simulation, and kept out of files where asked.

MuJoCo counts a simulation's warnings in its MjData. The first one of each kind it also hands to one
function of the whole process, which by itself writes MUJOCO_LOG.TXT into the current folder.
"""

import ctypes
from collections import Counter
from collections.abc import Iterable

import mujoco
import numpy as np

_KINDS = {
    mujoco.mjtWarning.mjWARN_INERTIA: "singular inertia",
    mujoco.mjtWarning.mjWARN_CONTACTFULL: "contact buffer full",
    mujoco.mjtWarning.mjWARN_CNSTRFULL: "constraint buffer full",
    mujoco.mjtWarning.mjWARN_BADQPOS: "bad position",
    mujoco.mjtWarning.mjWARN_BADQVEL: "bad velocity",
    mujoco.mjtWarning.mjWARN_BADQACC: "bad acceleration",
    mujoco.mjtWarning.mjWARN_BADCTRL: "bad control",
}


def warnings_of(simulations: Iterable[mujoco.MjData]) -> Counter[str]:
    """Returns how often MuJoCo has warned in these simulations since they were made, by kind."""
    counts = sum((data.warning.number for data in simulations), np.zeros(len(_KINDS), dtype=int))
    if not counts.any():
        return Counter()
    return Counter({kind: int(counts[at]) for at, kind in _KINDS.items() if counts[at]})


def in_words(warnings: Counter[str]) -> str:
    """Returns the counts as they stand in a sentence, such as `bad acceleration (3)`."""
    return ", ".join(f"{kind} ({count})" for kind, count in sorted(warnings.items()))


def silence_mujoco() -> None:
    """Keeps MuJoCo from writing its warnings to a file or to the terminal, in all of this process.

    Programs and nodes call it, since the process is theirs; a library must not. The function that
    gets the warnings is C's strlen, which does nothing to a text: MuJoCo's bindings look at a
    Python function by running a line of Python, and lose an interrupt that strikes it.
    """
    mujoco.set_mju_user_warning(ctypes.CDLL(None).strlen)
