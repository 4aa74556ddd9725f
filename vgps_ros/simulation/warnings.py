"""What MuJoCo warned of in this process, by kind.

MuJoCo hands its warnings to one function of the whole process; by itself it would write a file into
whatever folder the process was started in.
"""

from collections import Counter

import mujoco

# Words of MuJoCo's sentence, and what is said of it here.
_KINDS = {
    "QACC": "bad acceleration",
    "QVEL": "bad velocity",
    "QPOS": "bad position",
    "CTRL": "bad control",
    "contacts": "contact buffer full",
    "constraints": "constraint buffer full",
    "nertia": "singular inertia",
}

_counts: Counter[str] = Counter()


def kind_of(sentence: str) -> str:
    """Returns the kind of a warning, or `other`."""
    return next((kind for word, kind in _KINDS.items() if word in sentence), "other")


def _count(sentence: str) -> None:
    _counts[kind_of(sentence)] += 1


def count_warnings() -> None:
    """Lets MuJoCo's warnings be counted from now on."""
    mujoco.set_mju_user_warning(_count)


def simulator_warnings() -> Counter[str]:
    """Returns how often MuJoCo warned since the process began, by kind."""
    return _counts.copy()


def in_words(warnings: Counter[str]) -> str:
    """Returns the counts as they stand in a sentence, such as `bad acceleration (3)`."""
    return ", ".join(f"{kind} ({count})" for kind, count in sorted(warnings.items()))
