# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Refuses the MJCF of a stranger that reads files, or would take minutes or gigabytes to compile.

MuJoCo itself makes as many copies of a body as one word asks for, and takes a time that grows with
the square of their number.
"""

import math
import re
from pathlib import Path
from xml.etree import ElementTree

from vgps_ros.core.checks import quoted, told
from vgps_ros.core.errors import InvalidInputError

_MOST_ELEMENTS = 10_000  # which take a few seconds
_MOST_NUMBERS = 2**24  # of height fields, pictures, sensors and users
_COPIES = ("count", "nkey")  # attributes that are numbers of elements, along one axis or several
_SIDES = ("nrow", "ncol", "width", "height")  # of what is as large as the square of a side
_SIZES = ("dim", "nuserdata", "nsample", "actdim")
# What MuJoCo's XML might have where the standard's has nothing, as after <!DOCTYPE.
_WORDS = re.compile(rf"\b(file|nuser_|{'|'.join((*_COPIES, *_SIDES, *_SIZES))})")


def check_self_contained(mjcf: str) -> None:
    """Refuses references to files, which are private, and models that would become too large.

    Raises:
        InvalidInputError: the text has one, would become too large, or cannot be checked.
    """
    try:
        if "<!DOCTYPE" in mjcf:  # within which MuJoCo's XML begins earlier than the standard's
            raise ElementTree.ParseError("it declares a document type")
        robot = ElementTree.fromstring(mjcf)
    except ElementTree.ParseError as error:
        if found := _WORDS.search(mjcf):
            raise InvalidInputError(
                f"The robot's MJCF does not compile: it is no XML ({told(error)}), and so its "
                f"{found[0]} cannot be checked; mend the text there."
            ) from error
        return  # MuJoCo has the better message for it
    for element in robot.iter():
        files = [value for name, value in element.items() if name.startswith("file")]
        if files:
            raise InvalidInputError(
                f"The robot's MJCF refers to the file {quoted(files[0])}, but its text must "
                "hold all of the robot; leave out meshes, textures and includes."
            )
    if excess := _excess(robot):
        raise InvalidInputError(f"The robot's MJCF {excess}")


def excess_of_file(path: Path) -> str:
    """Returns what is too much in a file's own text, without what it includes; "" if nothing is."""
    try:
        excess = _excess(ElementTree.parse(path).getroot())
    except (OSError, ElementTree.ParseError, ValueError, LookupError):
        return ""  # MuJoCo has the better message for it
    return excess and f"the model {excess}"


def _excess(robot: ElementTree.Element) -> str:
    """Returns the end of a sentence on what a model has too much of; "" if it is not too large."""
    elements, numbers, users = 0, 0, 1
    waiting = [(robot, 1)]
    while waiting:
        element, copies = waiting.pop()
        copies *= math.prod(n for name in _COPIES for n in _numbers(element, name))
        copies = min(copies, 10**12)  # as a number with more digits would take long to multiply
        elements += copies
        numbers += copies * sum(n * n for name in _SIDES for n in _numbers(element, name))
        numbers += copies * sum(n for name in _SIZES for n in _numbers(element, name))
        names = (name for name in element.attrib if name.startswith("nuser_"))
        users += sum(n for name in names for n in _numbers(element, name))
        waiting += ((inner, copies) for inner in element)
    for count, most, what in (
        (elements, _MOST_ELEMENTS, "elements, copies (count) included"),
        (numbers + elements * users, _MOST_NUMBERS, "numbers in its fields, pictures and sensors"),
    ):
        if count > most:
            shown = count if count < 10**10 else "far too many"
            return f"asks for {shown} {what}, but it may have {most} at most; leave some out."
    return ""


def _numbers(element: ElementTree.Element, name: str) -> list[int]:
    """Returns the whole numbers of an attribute, at least 0; MuJoCo refuses what is no number."""
    try:
        return [max(int(word), 0) for word in element.get(name, "").split()]
    except ValueError:
        return []
