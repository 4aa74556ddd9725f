"""The folder that a training leaves: the names of its files, and how they are written and read."""

import json
from pathlib import Path
from typing import Any

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.storage.files import write_json
from vgps_ros.storage.policy_file import save_policy


class RunFolder:
    """Names the files of a run."""

    def __init__(self, path: Path):
        self.path = path
        self.result = path / "result.json"  # metrics of each iteration
        self.policy = path / "policy.json"  # of the last iteration
        self.distribution = path / "distribution.npz"  # q(ζ) of each initial state at the end
        self.trajectories = path / "trajectories.npz"  # motions to draw where there is no bag
        self.learning_curve = path / "learning_curve.png"
        self.checkpoints = path / "checkpoints"  # a folder, empty once the training has ended
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
        content: dict[str, Any] = json.loads(path.read_text())
        _ = content["task"], content["initial_ddp_cost"], content["iterations"][-1]["k"]
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InvalidInputError(f"'{path}' is not a result.json of a training: {error}.") from error
    return content
