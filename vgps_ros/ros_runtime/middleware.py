# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The limits of the middleware that a process meets at its start: shared memory and ports.

Without these checks a process ends with a bus error where /dev/shm is full, and runs alone without
a word where it is one process more than the others announce themselves to. Once a process runs,
/dev/shm may fill: Fast DDS has given the segment all of its memory, and later peers use UDP.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from xml.etree import ElementTree

from vgps_ros.core.errors import VgpsError

_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_HEEDED = "RMW_FASTRTPS_USE_QOS_FROM_XML"  # whether the profile says how readers keep memory
_SHARED_MEMORY = Path("/dev/shm")
_TRACING = "lttng-ust-wait-*"  # files of LTTng there, which rclpy loads
_TRACING_NEEDS = 2**15  # of which most is a margin [bytes]
_USUAL_SEGMENT = 2**19  # without a profile [bytes]
_BESIDE = 2**21  # for ports and locks [bytes]
_LIST = 0.06  # size of the list of a segment's blocks, as a part of the segment
_FIRST_PORT, _LAST_PORT, _PORTS_PER_DOMAIN, _PORTS_PER_PLACE = 7410, 65535, 250, 2
_done_without: list[str] = []  # a sentence, if this process had to do without shared memory


def check_machine() -> None:
    """Checks that rclpy can be imported, whose tracing reads two pages of /dev/shm, and begin.

    Raises:
        VgpsError: it would end with a bus error; or ROS_DOMAIN_ID is no domain, or one with fewer
            ports than the profile announces to.
    """
    _check_ports(os.environ.get("ROS_DOMAIN_ID", ""))
    files = list(_SHARED_MEMORY.glob(_TRACING))
    has_pages = bool(files) and all(file.stat().st_blocks for file in files)
    if not has_pages and (free := _free_memory()) < _TRACING_NEEDS:
        raise VgpsError(
            f"/dev/shm has {free} bytes free, but ROS 2 needs {_TRACING_NEEDS} to start at all: "
            "free some space there (`df /dev/shm` shows it), and start this again."
        )


@contextmanager
def within_limits() -> Iterator[None]:
    """Wraps the making of a process's first node, with which the middleware begins.

    Where /dev/shm is too full for it, the middleware does without. It manages the memory of queues
    as the profile says, if the profile says so for all of them.
    """
    profile = None
    if all(map(_says_memory, ("data_writer", "data_reader"))):
        os.environ.setdefault(_HEEDED, "1")
    try:
        needed, free = _needed_memory(), _free_memory()
        if free < needed:
            _done_without.append(
                f"/dev/shm has {free * 1e-6:.1f} MB free, but the middleware takes "
                f"{needed * 1e-6:.1f} MB there, so this process uses UDP alone, which is slower "
                "for large messages; free some space, and start it again."
            )
            profile = _leave_out_shared_memory()
        yield
    finally:
        if profile:
            profile.unlink(missing_ok=True)


def trouble(domain_id: int) -> str:
    """Returns a sentence on the limit that this process has hit; empty if it has hit none."""
    reach = _reach()
    if reach and not any(place < reach for place in _places(domain_id)):
        return (
            f"This process has none of the {reach} places of domain {domain_id} to which others "
            "announce themselves, so it may find nobody: end other ROS programs, or use another "
            "ROS_DOMAIN_ID."
        )
    return " ".join(_done_without)


def _reach() -> int:
    """Returns to how many places of a domain a process announces itself; 0 if nothing says it."""
    return min((int(element.text or 0) for element in _profile("maxInitialPeersRange")), default=0)


def _check_ports(domain_id: str) -> None:
    highest = (_LAST_PORT - _FIRST_PORT - _PORTS_PER_PLACE * _reach() + 1) // _PORTS_PER_DOMAIN
    if domain_id and domain_id not in map(str, range(highest + 1)):
        raise VgpsError(
            f"ROS_DOMAIN_ID is '{domain_id:.20}', but it must be 0 to {highest}: domains beyond "
            "have too few ports for all processes that must find each other. Choose a lower one."
        )


def _profile(name: str) -> list[ElementTree.Element]:
    """Returns the elements of the profile that have a name; none if there is no valid profile."""
    with suppress(OSError, ElementTree.ParseError):
        elements = ElementTree.parse(os.environ.get(_PROFILE, "")).iter()
        return [element for element in elements if _name(element) == name]
    return []


def _says_memory(kind: str) -> bool:
    """Returns whether the profile says how all writers, or all readers, manage their memory."""
    return any(
        endpoint.get("is_default_profile") == "true" and _text(endpoint, "historyMemoryPolicy")
        for endpoint in _profile(kind)
    )


def _name(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _text(element: ElementTree.Element, name: str) -> str:
    return next((child.text or "" for child in element if _name(child) == name), "")


def _needed_memory() -> int:
    """Returns the shared memory that the middleware will take [bytes]."""
    transports = _profile("transport_descriptor")
    sizes = [
        int(_text(transport, "segment_size") or _USUAL_SEGMENT)
        for transport in transports
        if _text(transport, "type") == "SHM"
    ]
    if not sizes and transports:  # those of the profile, which do not use it
        return 0
    return _BESIDE + round(sum(sizes or [_USUAL_SEGMENT]) * (1.0 + _LIST))


def _free_memory() -> int:
    try:
        space = os.statvfs(_SHARED_MEMORY)
    except FileNotFoundError:  # a system that has its shared memory elsewhere
        return sys.maxsize
    return space.f_bavail * space.f_frsize


def _leave_out_shared_memory() -> Path | None:
    """Has the middleware do without; returns the profile that it reads, to be removed later."""
    if not _profile("transport_descriptor"):
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"
        return None
    tree = ElementTree.parse(os.environ[_PROFILE])
    ElementTree.register_namespace("", tree.getroot().tag.partition("}")[0].removeprefix("{"))
    names = set()
    for parent in list(tree.iter()):
        for child in list(parent):
            if _name(child) == "transport_descriptor" and _text(child, "type") == "SHM":
                names.add(_text(child, "transport_id"))
                parent.remove(child)
    for parent in list(tree.iter()):
        for child in list(parent):
            if _name(child) == "transport_id" and child.text in names:
                parent.remove(child)
    with tempfile.NamedTemporaryFile(prefix="vgps_ros_", suffix=".xml", delete=False) as file:
        tree.write(file)
    os.environ[_PROFILE] = file.name
    return Path(file.name)


def _places(domain_id: int) -> list[int]:
    """Returns the places of a domain that this process has; each is a pair of ports."""
    own = set()
    for file in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):
            own.add(os.readlink(file))
    first = _FIRST_PORT + _PORTS_PER_DOMAIN * domain_id
    places = []
    for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]:
        words = line.split()
        place, rest = divmod(int(words[1].rpartition(":")[2], 16) - first, _PORTS_PER_PLACE)
        if f"socket:[{words[9]}]" in own and place >= 0 and rest == 0:
            places.append(place)
    return places
