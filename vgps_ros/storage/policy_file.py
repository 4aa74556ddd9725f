"""Policies, and other results, as JSON files.

Loading JSON can run no code, and a person can read it. Numbers are written with the shortest
digits that read back to the same bits.
"""

import json
from pathlib import Path

import numpy as np

from vgps_ros.core.checks import finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.storage.files import write_json


def save_policy(policy: GaussianPolicy, task: str, path: Path) -> None:
    """Writes a policy that `load_policy` reads back bit for bit."""
    shape = policy.architecture
    write_json(
        path,
        {
            "task": task,
            "observed": list(shape.observed),
            "hidden_units": list(shape.hidden_units),
            "control_dim": shape.control_dim,
            "activation": shape.activation,
            "hidden_bias": shape.hidden_bias,
            "output_bias": shape.output_bias,
            "parameters": policy.parameters.tolist(),
            "noise_std": policy.noise_std.tolist(),
        },
    )


def load_policy(path: Path) -> tuple[GaussianPolicy, str]:
    """Reads a policy and the name of its task.

    Raises:
        InvalidInputError: the file is missing, is not a policy, or its values do not fit.
    """
    try:
        content = json.loads(path.read_text())
        shape = Architecture(
            observed=tuple(content["observed"]),
            hidden_units=tuple(content["hidden_units"]),
            control_dim=content["control_dim"],
            activation=content["activation"],
            hidden_bias=content["hidden_bias"],
            output_bias=content["output_bias"],
        )
        policy = GaussianPolicy(
            shape,
            finite_array("parameters", content["parameters"], (shape.num_parameters,)),
            np.array(content["noise_std"], dtype=float),
        )
        return policy, str(content["task"])
    except (OSError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InvalidInputError(
            f"{path} is not a readable policy file ({error}); name the policy.json of a run."
        ) from error
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError(
            f"{path} is not a policy of vgps_ros ({error}); name the policy.json of a run."
        ) from error
