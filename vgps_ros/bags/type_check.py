# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks that the definitions by which a bag is read are those of the types that it names."""

from rosbags.typesys import Stores, get_typestore

from vgps_ros.bags.reader import BagReader


def altered_types(bag: BagReader) -> list[str]:
    """Returns those of the types read so far whose definition in the bag is not that of their hash.

    Types of ROS 2 itself must be as Jazzy has them, whichever hash the bag gives.

    Raises:
        InvalidInputError: a definition cannot be read.
    """
    standard, altered = get_typestore(Stores.ROS2_JAZZY), set()
    for topic, kind in bag.topics.items():
        if kind not in bag.types_read:
            continue
        hashes = {bag.definition_hash(kind)}
        if recorded := bag.type_hashes[topic]:  # which bags of older ROS 2 lack
            hashes.add(recorded)
        if kind in standard.fielddefs:
            hashes.add(standard.hash_rihs01(kind))
        if len(hashes) > 1:
            altered.add(kind)
    return sorted(altered)
