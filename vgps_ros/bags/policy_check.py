# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks that a bag's policies are those that their learner published."""

from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_policies import learned_policy, onnx_content, policy_messages
from vgps_ros.bags.timeline import SLACK
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.policy_file import PolicyFile, policy_digest


@dataclass
class PolicyCheck:
    """The outcome of a check, as numbers of policies.

    Attributes:
        proven: those whose digest is what their learner, or a file, says.
        unproven: those of which nobody says a digest.
        altered: the iterations of those that have another digest than their learner says.
        refused: a sentence on each that cannot be read.
        missing: those that are not in the bag, although their learner says a digest.
    """

    proven: int
    unproven: int
    altered: list[int]
    refused: list[str]
    missing: int = 0


class _Link(NamedTuple):
    """A digest in the chain of a training, as its learner says it just after the policy."""

    received: int  # [ns]
    digest: str
    before: str | None  # of the iteration before; None if that is not in the bag


def check_policies(bag: BagReader, trusted: PolicyFile | None = None) -> PolicyCheck:
    """Compares each policy with the chain of digests in `learning_progress`.

    Args:
        bag: the bag.
        trusted: a policy that needs no learner, such as one that was loaded from a file.
    """
    links = _links(bag)
    found = PolicyCheck(0, 0, [], [])
    missing = {link for several in links.values() for link in several}
    trusted_digest = policy_digest(trusted.gaussian) if trusted and trusted.gaussian else ""
    for received, message in policy_messages(bag, found.refused):
        if (content := onnx_content(message)) is not None:
            is_trusted = trusted is not None and content == trusted.content
            found.proven += is_trusted
            found.unproven += not is_trusted
            continue
        try:
            k, policy = int(message.iteration), learned_policy(message)
        except InvalidInputError as error:
            found.refused.append(str(error))
            continue
        several = links[message.task, k]
        befores = {link.before for link in several}
        digests = {policy_digest(policy, before) for before in befores if before is not None}
        matching = {link for link in several if link.digest in digests}
        # One that a learner keeps for late subscribers may be of a training before the bag.
        own = [link for link in several if abs(link.received - received) <= SLACK]
        missing -= matching or set(own)
        if matching or policy_digest(policy) == trusted_digest:
            found.proven += 1
        elif own and None not in befores:
            found.altered.append(k)
        else:
            found.unproven += 1
    found.missing = len(missing)
    return found


def _links(bag: BagReader) -> dict[tuple[str, int], list[_Link]]:
    """Reads the digests by task and iteration; a bag may hold several trainings."""
    links: dict[tuple[str, int], list[_Link]] = defaultdict(list)
    latest: dict[str, tuple[int, str]] = {}  # the newest iteration of a task, and its digest
    topic = bag.filled_topics.get("learning_progress")
    for received, message in bag.decoded(topic) if topic else ():
        digest, task, k = getattr(message, "policy_digest", ""), message.task, message.iteration
        iteration, newest = latest.get(task, (0, ""))
        before = "" if k == 1 else newest if iteration == k - 1 else None
        if digest:
            links[task, k].append(_Link(received, digest, before))
        latest[task] = (k, digest)
    return links
