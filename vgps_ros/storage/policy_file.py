"""Policies as JSON files: loading one can run no code, and a person can read it.

The keys are the names of the record's fields. Numbers are written with the shortest digits that
read back to the same bits.
"""

import json
from dataclasses import asdict
from pathlib import Path

from vgps_ros.core.arrays import arrays_of, declared_shapes
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.storage.files import write_json
from vgps_ros.storage.record_tree import from_entries


def save_policy(policy: GaussianPolicy, task: str, path: Path) -> None:
    """Writes a policy that `load_policy` reads back bit for bit."""
    arrays = {name: values.tolist() for name, values in arrays_of(policy).items()}
    write_json(path, {"task": task, **asdict(policy.architecture), **arrays})


def load_policy(path: Path) -> tuple[GaussianPolicy, str]:
    """Reads a policy and the name of its task.

    Raises:
        InvalidInputError: the file is missing, is not a policy, or its values do not fit.
    """
    try:
        content = json.loads(path.read_text())
    except (OSError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InvalidInputError(
            f"{path} is not a readable policy file ({error}); name the policy.json of a run."
        ) from error
    try:
        shape = from_entries(Architecture, content, {})
        arrays = {name: content[name] for name in declared_shapes(GaussianPolicy)}
        return GaussianPolicy(shape, **arrays), str(content["task"])
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError(
            f"{path} is not a policy of vgps_ros ({error}); name the policy.json of a run."
        ) from error
