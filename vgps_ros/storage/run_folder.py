# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The folder that a training leaves: the names of its files, and how they are written and read.

Loading a file can run no code. A policy is JSON text that a person can read: the keys are the names
of the record's fields, and numbers have the shortest digits that read back to the same bits.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.checks import array_shapes, arrays_of, check_array, declared_shapes, from_arrays
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.storage.files import from_entries, read_archive, read_json, write_archive, write_json


class RunFolder:
    """Names the files of a run."""

    def __init__(self, path: Path):
        self.path = path
        self.result = path / "result.json"  # metrics of each iteration
        self.policy = path / "policy.json"  # of the last iteration
        self.distribution = path / "distribution.npz"  # q(ζ) of each initial state at the end
        self.trajectories = path / "trajectories.npz"  # motions to draw where there is no bag
        self.environment = path / "environment.yaml"  # what the bytes of the others depend on
        self.learning_curve = path / "learning_curve.png"
        self.checkpoints = path / "checkpoints"  # a folder, empty once the training has ended
        self.events = path / "tensorboard"  # a folder of event files, where they were asked for
        self.bag = path / "bag"  # a folder, if the run was recorded

    def is_finished(self) -> bool:
        """Returns whether a training has ended here: it removes its checkpoints at the end."""
        return self.result.is_file() and not any(self.checkpoints.rglob("*.npz"))

    def file_names(self) -> str:
        """Returns the names of the files that are there, for a sentence."""
        files = (self.result, self.policy, self.distribution, self.trajectories)
        *names, last = [f.name for f in (*files, self.learning_curve) if f.is_file()]
        return f"{', '.join(names)} and {last}"

    def save(self, result: dict[str, Any], policy: GaussianPolicy) -> None:
        """Writes result.json and policy.json, each in one piece; makes the folder if needed."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_json(self.result, result)
        save_policy(policy, result["task"], self.policy)


def read_result(path: Path) -> dict[str, Any]:
    """Returns the content of a result.json.

    Raises:
        InvalidInputError: the file is missing, or is not that of a training.
    """
    try:
        content: dict[str, Any] = read_json(path)
        _ = content["task"], content["initial_ddp_cost"], content["iterations"][-1]["k"]
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InvalidInputError(f"'{path}' is not a result.json of a training: {error}.") from error
    return content


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
        content = read_json(path)
    except (OSError, ValueError) as error:
        cause = getattr(error, "strerror", error)
        sentence = f"{path} is not a readable policy file ({cause}); name the policy.json of a run."
        raise InvalidInputError(sentence) from error
    try:
        shape = from_entries(Architecture, content, {})
        arrays = {name: content[name] for name in declared_shapes(GaussianPolicy)}
        return GaussianPolicy(shape, **arrays), str(content["task"])
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError(
            f"{path} is not a policy of vgps_ros ({error}); name the policy.json of a run, and "
            "train again where an older version wrote it."
        ) from error


def save_distributions(
    distributions: Sequence[TrajectoryDistribution], task: str, path: Path
) -> None:
    """Writes distributions of one horizon in one piece; they are read back bit for bit."""
    found = [arrays_of(q) for q in distributions]
    stacked = {_key(name): np.stack([arrays[name] for arrays in found]) for name in found[0]}
    write_archive(path, {"task": np.array(task), **stacked})


def load_distributions(path: Path) -> tuple[list[TrajectoryDistribution], str]:
    """Reads distributions and the name of their task.

    Raises:
        InvalidInputError: the file is missing, holds no distributions, or its arrays do not fit.
    """
    try:
        file = read_archive(path)
        (count, horizon, n_u), n_x = file["controls"].shape, file["states"].shape[-1]
        if not file["states"].size:
            raise ValueError("it has no states")
        sizes = {"n_x": n_x, "n_dx": file["gains"].shape[-1], "n_u": n_u}
        sizes["n_z"] = file["context"].shape[-1]
        shapes = array_shapes(TrajectoryDistribution, T=horizon, **sizes)
        arrays = {name: file[_key(name)].astype(float) for name in shapes}
        for name, shape in shapes.items():
            check_array(_key(name), arrays[name], (count, *shape))
        task = str(file["task"])
    except OSError as error:
        raise InvalidInputError(f"{path} is not a readable distribution file: {error}.") from error
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InvalidInputError(f"{path} holds no distributions of vgps_ros: {error}.") from error
    return [
        from_arrays(TrajectoryDistribution, {name: arrays[name][i] for name in shapes})
        for i in range(count)
    ], task


def _key(name: str) -> str:
    """Returns an array's name in the file, which is that of its own record's field."""
    return name.rpartition(".")[2]


def policy_digest(policy: GaussianPolicy, before: str = "") -> str:
    """Returns the SHA-256 of a policy and of the digest before it, in hexadecimal.

    So each digest of a training vouches for all policies before it.

    Args:
        policy: the policy of iteration k; each bit of its arrays counts, and its shape.
        before: the digest of iteration k − 1; empty for the first.
    """
    digest = hashlib.sha256(f"{before}{json.dumps(asdict(policy.architecture))}".encode())
    for values in arrays_of(policy).values():
        digest.update(values.astype("<f8").tobytes())
    return digest.hexdigest()
