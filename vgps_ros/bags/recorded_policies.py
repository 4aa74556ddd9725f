# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The policies of a bag: those of a learner, and networks of others as ONNX files."""

from collections.abc import Iterator, Sequence
from typing import Any

from vgps_ros.bags.reader import BagReader
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.messages.conversions import policy_from_msg
from vgps_ros.policies.onnx_policy import OnnxPolicy

ONNX = "onnx_policy"  # on which an executor that was started with such a file publishes it


def policy_messages(bag: BagReader, refused: list[str] | None = None) -> Iterator[tuple[int, Any]]:
    """Returns the time of receipt [ns] and the message of each policy, in their order.

    Args:
        bag: the bag.
        refused: takes a sentence on each message that cannot be read; without it, one raises.

    Raises:
        InvalidInputError: the bag has no policy, or a message is none.
    """
    topics = [bag.filled_topics[name] for name in ("policy", ONNX) if name in bag.filled_topics]
    return bag.decoded(*(topics or [bag.needed_topic("policy")]), refused=refused)


def learned_policy(message: Any) -> GaussianPolicy:
    """Returns the policy that a message of a learner holds.

    Raises:
        InvalidInputError: it holds none.
    """
    try:
        return policy_from_msg(message)
    except InvalidInputError as error:
        raise InvalidInputError(
            f"The policy of iteration {message.iteration} cannot be read: {error}"
        ) from error


def onnx_content(message: Any) -> bytes | None:
    """Returns the bytes of an ONNX file, or None if the message is a policy of a learner."""
    return bytes(message.data) if hasattr(message, "data") else None


def onnx_policy(content: bytes, joints: Sequence[str]) -> OnnxPolicy:
    """Returns the network that a bag holds, for a robot whose controls drive these joints.

    Raises:
        InvalidInputError: the bytes are no policy of this robot.
    """
    return OnnxPolicy(content, f"The message on {ONNX}", joints)
