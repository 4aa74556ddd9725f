# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks that a bag's policies are those that their learner published."""

from collections import defaultdict
from dataclasses import dataclass

from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_policies import learned_policy, onnx_content, policy_messages
from vgps_ros.storage.policy_digest import policy_digest
from vgps_ros.storage.policy_file import PolicyFile


@dataclass
class PolicyCheck:
    """The outcome of a check, as numbers of policies.

    Attributes:
        proven: those whose digest is what their learner, or a file, says.
        unproven: those of which nobody says a digest.
        altered: the iterations of those that have another digest than their learner says.
    """

    proven: int
    unproven: int
    altered: list[int]


def check_policies(bag: BagReader, trusted: PolicyFile | None = None) -> PolicyCheck:
    """Compares each policy with the chain of digests in `learning_progress`.

    Args:
        bag: the bag.
        trusted: a policy that needs no learner, such as one that was loaded from a file.

    Raises:
        InvalidInputError: a policy cannot be read.
    """
    # By task and iteration, since a bag may hold several trainings.
    said: dict[tuple[str, int], set[str]] = defaultdict(set)
    topic = bag.filled_topics.get("learning_progress")
    for _, message in bag.decoded(topic) if topic else ():
        digest = getattr(message, "policy_digest", "")
        if digest:
            said[message.task, message.iteration].add(digest)
    found = PolicyCheck(0, 0, [])
    trusted_digest = policy_digest(trusted.gaussian) if trusted and trusted.gaussian else ""
    for _, message in policy_messages(bag):
        if (content := onnx_content(message)) is not None:
            is_trusted = trusted is not None and content == trusted.content
            found.proven += is_trusted
            found.unproven += not is_trusted
            continue
        k = int(message.iteration)
        wanted = said[message.task, k]
        before = said[message.task, k - 1] if k > 1 else {""}
        policy = learned_policy(message)
        digests = {policy_digest(policy, digest) for digest in before}
        if digests & wanted or policy_digest(policy) == trusted_digest:
            found.proven += 1
        elif wanted and before:
            found.altered.append(k)
        else:
            found.unproven += 1
    return found
