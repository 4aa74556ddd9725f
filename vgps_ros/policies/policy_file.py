# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Opens the file of a policy (policy.json, or an ONNX file, also a third-party one); digests."""

from dataclasses import dataclass
from pathlib import Path

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.policies.onnx_file import LARGEST, from_onnx, metadata_of, parse_model
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.robot.controls import Controls
from vgps_ros.storage.files import read_file
from vgps_ros.storage.run_folder import load_policy

Policy = GaussianPolicy | OnnxPolicy


@dataclass(frozen=True)
class PolicyFile:
    """A policy that was read from a file."""

    name: str  # what the sentence of an error calls the file
    task: str  # that the file names; empty if it names none
    gaussian: GaussianPolicy | None  # if vgps_ros wrote the file; None: a third-party network
    content: bytes = b""  # of an ONNX file; empty for policy.json

    def policy(self, controls: Controls) -> Policy:
        """Returns the policy for a robot.

        Args:
            controls: what the robot's controls are.

        Raises:
            InvalidInputError: a third-party network does not fit the robot, or cannot be executed.
        """
        return self.gaussian or OnnxPolicy(self.content, self.name, controls)


def open_policy(path: Path) -> PolicyFile:
    """Opens a policy.json or an ONNX file.

    Raises:
        InvalidInputError: the file is missing, or holds no policy.
    """
    if path.suffix == ".onnx":
        try:
            return policy_of(read_file(path, LARGEST), f"'{path}'")
        except OSError as error:
            raise InvalidInputError(
                f"'{path}' cannot be read: {error.strerror}; name the ONNX file of a policy."
            ) from error
    policy, task = load_policy(path)
    return PolicyFile(f"'{path}'", task, policy)


def policy_of(content: bytes, name: str) -> PolicyFile:
    """Returns the policy in the bytes of an ONNX file.

    Raises:
        InvalidInputError: the bytes are no ONNX model that may be read.
    """
    exported = from_onnx(content, name)
    task = metadata_of(parse_model(content, name)).get("task", "")
    return PolicyFile(name, task, exported.policy if exported else None, content)
