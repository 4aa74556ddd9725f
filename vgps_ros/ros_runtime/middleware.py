# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The middleware as a process of this project uses it, and the limits that the process meets.

Everything goes through UDP. In Fast DDS's shared memory all senders to a process share a lock with
it: one that is stopped while it holds the lock makes the others wait for seconds, and the ports
that Fast DDS then makes anew may be two of one name, so that a process hears nothing for good.
"""

import os
import sys
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

from vgps_ros.core.errors import VgpsError

_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_HEEDED = "RMW_FASTRTPS_USE_QOS_FROM_XML"  # whether the profile says how readers keep memory
_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"  # those of a process whose profile names none
_SHARED_MEMORY = Path("/dev/shm")
_TRACING = "lttng-ust-wait-*"  # files of LTTng there, which rclpy loads
_TRACING_NEEDS = 2**15  # of which most is a margin [bytes]
_FIRST_PORT, _LAST_PORT, _PORTS_PER_DOMAIN, _PORTS_PER_PLACE = 7410, 65535, 250, 2


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


def choose_middleware() -> None:
    """Sets, before a process's first node, what neither its environment nor its profile says.

    It talks through UDP alone, and manages the memory of queues as the profile says, if the profile
    says so for all of them.
    """
    os.environ.setdefault(_TRANSPORTS, "UDPv4")
    if all(map(_says_memory, ("data_writer", "data_reader"))):
        os.environ.setdefault(_HEEDED, "1")


def trouble(domain_id: int) -> str:
    """Returns a sentence on the limit that this process has hit; empty if it has hit none."""
    reach = _reach()
    if reach and not any(place < reach for place in _places(domain_id)):
        return (
            f"This process has none of the {reach} places of domain {domain_id} to which others "
            "announce themselves, so it may find nobody: end other ROS programs, or use another "
            "ROS_DOMAIN_ID."
        )
    return ""


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


def _free_memory() -> int:
    try:
        space = os.statvfs(_SHARED_MEMORY)
    except FileNotFoundError:  # a system that has its shared memory elsewhere
        return sys.maxsize
    return space.f_bavail * space.f_frsize


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
