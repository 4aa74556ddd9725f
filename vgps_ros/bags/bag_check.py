# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Says of a bag what is proven, what is wrong, and what cannot be proven."""

from dataclasses import dataclass, field
from pathlib import Path

from vgps_ros.bags import BagReader
from vgps_ros.bags.manifest import check_manifest, signer
from vgps_ros.bags.metadata import contradictions
from vgps_ros.bags.policy_check import check_policies
from vgps_ros.bags.torque_check import TOLERANCE, check_torques
from vgps_ros.bags.torque_counts import TorqueCheck
from vgps_ros.bags.type_check import altered_types
from vgps_ros.policies.policy_file import PolicyFile


@dataclass
class BagCheck:
    """The outcome of a check, in words that follow "Proven: ", "Wrong: " and "Not proven: ".

    Attributes:
        proven: what is proven, and of how much.
        wrong: what contradicts a genuine record.
        unproven: what nothing in the bag proves.
        torques: the torques by what they are.
    """

    proven: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    unproven: list[str] = field(default_factory=list)
    torques: TorqueCheck = field(default_factory=TorqueCheck)


def check_bag(
    path: Path,
    trusted: PolicyFile | None = None,
    signers: Path | None = None,
    namespace: str | None = None,
) -> BagCheck:
    """Checks a whole bag: its torques, its policies, and its files.

    Args:
        path: folder of the bag.
        trusted: a policy that the executor was started with; None if all came from a learner.
        signers: file of the signers that are trusted; None if the bag need not be signed.
        namespace: of the robot that is meant, for a bag of several.

    Raises:
        InvalidInputError: the bag cannot be read, lacks a topic, or is not signed as it should be.
    """
    found = BagCheck()
    with BagReader(path, namespace) as bag:
        found.torques = check_torques(bag)
        _judge_torques(found)
        policies = check_policies(bag, trusted)
        altered = altered_types(bag)
        found.wrong += [f"the definition of {kind} is not that type's" for kind in altered]
        found.wrong += bag.damages
    total = policies.proven + policies.unproven + len(policies.altered) + len(policies.refused)
    if policies.proven:
        found.proven.append(f"{policies.proven} of {total} policies")
    found.wrong += [f"the policy of iteration {k} is not its learner's" for k in policies.altered]
    found.wrong += _refused("policies", policies.refused)
    if policies.unproven:
        found.unproven.append(f"{policies.unproven} policies, of which no learner says a digest")
    _judge_files(found, bag)
    if policies.missing:
        found.unproven.append(f"{policies.missing} policies that the learner named are missing")
    if signers:
        found.proven.append(f"the signature of {signer(path, signers)}")
    return found


def _refused(kind: str, sentences: list[str]) -> list[str]:
    if not sentences:
        return []
    return [f"{len(sentences)} {kind} cannot be read; of the first one: {sentences[0].rstrip('.')}"]


def _judge_torques(found: BagCheck) -> None:
    torques = found.torques
    agreeing = torques.deterministic + torques.stochastic + torques.close
    explained = agreeing + torques.safe + torques.last
    total = explained + torques.rounded + torques.unchecked + torques.stateless
    total += torques.unexplained + torques.different + torques.early
    if explained:
        found.proven.append(f"{explained} of {total} torques")
    for count, words in (
        (torques.different, "torques differ from what the policy gives"),
        (torques.unexplained, "torques are zero or safe, and nothing says that they had to be"),
        (torques.stateless, "torques answer states that are not in the bag, or are unusable"),
        (torques.unanswered, "states lack the torque that answers them"),
        (torques.surplus, "torques are more than the states that they answer"),
        (torques.disordered, "torques came after that of a later state"),
    ):
        if count:
            found.wrong.append(f"{count} {words}")
    found.wrong += torques.parameters + _refused("commands", torques.refused)
    for count, words in (
        (torques.early, "torques came before the first state"),
        (torques.unknown, "states lack a torque, and the executor said nothing when they came"),
        (torques.absent, "states are missing between those that are there"),
    ):
        if count:
            found.unproven.append(f"{count} {words}")
    if torques.rounded:
        found.unproven.append(
            f"{torques.rounded} torques of an old version, which computed them by BLAS; they agree "
            f"within {TOLERANCE:g} of the largest"
        )
    if torques.unchecked:
        found.unproven.append(f"{torques.unchecked} torques that torque_rate_limit bounds")
    if not torques.counted:
        found.unproven.append("the number of torques, which the executor did not count")
    elif torques.counted.missing or torques.counted.surplus:
        less, more = torques.counted.missing, torques.counted.surplus
        found.wrong.append(f"the executor counted {less} torques more and {more} less")


def _judge_files(found: BagCheck, bag: BagReader) -> None:
    for file in bag.files:
        if count := file.content.misplaced():
            found.wrong.append(f"{count} chunks are not where the index of {file.path.name} says")
    manifest = check_manifest(bag.path)
    if manifest is None:
        found.unproven.append("the files, since the bag has no manifest.json")
        return
    found.proven.append(f"{manifest.chunks} chunks in {manifest.files} files")
    found.wrong += manifest.wrong
    if manifest.messages != {topic: count for topic, count in bag.counts.items() if count}:
        found.wrong.append("the numbers of messages are not those of the recorder")
    told = contradictions(bag.path, (file.summary for file in bag.files), bag.type_hashes)
    found.wrong += [f"{key} in metadata.yaml is not that of the files" for key in told]
    if manifest.lost:
        found.unproven.append(f"{manifest.lost} messages, which the recorder lost")
