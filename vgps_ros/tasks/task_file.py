# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a task file: a control problem as data, in one YAML file beside a robot's MJCF.

For example, a pendulum that is swung up:

    # yaml-language-server: $schema=/path/of/vgps_ros/tasks/task.schema.json
    model: pendulum.xml
    control_period: 0.02                                     # [s]
    horizon: 3.0                                             # [s]
    sensors:
      tip: {type: framepos, site: tip}
    cost:
      - {sensor: tip, index: z, target: 1.0}
      - {control: all, weight: 1.0e-3}
    observe: [{joint: hinge, as: sin_cos}, joint_velocities]
    begin: {law: noise, std: 1.0}                            # [N·m]

The first line makes editors that know yaml-language-server check the file and show descriptions; it
names the path of `task.schema.json`, which lies beside this module. `schema` has all keys.

ruamel.yaml parses the text and knows the line of each entry, so that errors can name it; msgspec
judges the values, and the JSON schema of the records says what would be right. The file may be
untrusted: no objects are made, and anchors and aliases are refused. Numbers are those of YAML 1.2,
in which `1e-4` is a number and `yes` is a text. A key without a value counts as left out.
"""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from ruamel.yaml import YAML, MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.parser import ParserError
from ruamel.yaml.scanner import ScannerError

from vgps_ros.core.checks import list_names, nearest, one_of, quote
from vgps_ros.core.errors import InvalidEntryError, InvalidInputError, Place, at_entry, refuse_if
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import with_values, wrong_value
from vgps_ros.robot.signals import SOURCE
from vgps_ros.simulation.packages import package_folders
from vgps_ros.simulation.sensor_types import OBJECTS, SENSOR_TYPES
from vgps_ros.tasks.schema import (
    Begin,
    CommandEntry,
    CostTerm,
    Followed,
    ObservedEntry,
    PathMotion,
    Record,
    RecordedMotion,
    Sampling,
    Sensor,
    TaskFile,
)

R = TypeVar("R", bound=msgspec.Struct)

SCHEMA_PATH = Path(__file__).resolve().with_name("task.schema.json")
LARGEST_FILE = 1_000_000  # [bytes]
MOST_STEPS = 100_000
_PACKAGE = re.compile(r"package://([A-Za-z]\w*)/(.+)")
_LONGEST_ERROR = 480
_ROUNDING = 1e-6  # relative error up to which a time counts as a whole multiple of another
_OF_SENSORS = ("index", "target", "norm", "width", "when")


@dataclass(frozen=True)
class Document:
    """The data of a file.

    Attributes:
        path: the file.
        data: its top level.
        lines: the line of each entry, such as ("cost", 0, "sensor"); () is the whole file.
    """

    path: Path
    data: dict[str, Any]
    lines: dict[Place, int]

    @property
    def folder(self) -> Path:
        """The folder from which the file names others."""
        return self.path.parent

    def error(self, place: Place, sentence: str) -> InvalidInputError:
        """Returns an error that begins with file, line and key of an entry.

        Args:
            place: the entry; for one that the file leaves out, the line is that of its parent.
            sentence: what is wrong and what would be right, with its full stop.
        """
        known = next(place[:n] for n in range(len(place), -1, -1) if place[:n] in self.lines)
        where = f", {_place_in_words(place)}" if place else ""
        return self.error_at(self.lines[known], sentence, where)

    def error_at(self, line: int, sentence: str, where: str = "") -> InvalidInputError:
        """Returns an error that begins with the file and a line of it."""
        return InvalidInputError(shorten(f"{show_path(self.path)} line {line}{where}: {sentence}"))

    @contextmanager
    def name_lines(self) -> Iterator[None]:
        """Prefixes errors about entries within the block with file, line and key."""
        try:
            yield
        except InvalidEntryError as error:
            raise self.error(error.place, error.sentence) from error


def file_inside(folder: Path, name: str) -> Path:
    """Returns the path of a file that an entry names, which must lie in a folder.

    Raises:
        InvalidInputError: the file lies elsewhere, or there is none.
    """
    inside = folder.resolve()
    path = _existing_file(inside, name).resolve()
    if not path.is_relative_to(inside):
        raise InvalidInputError(
            f"the file {quote(name)} lies outside this file's folder; move it there."
        )
    return path


def _existing_file(folder: Path, name: str) -> Path:
    """Returns the path of a file that an entry names, from a folder.

    Raises:
        InvalidInputError: there is no such file.
    """
    try:
        path = folder / name
        if path.is_file():
            return path
        others = [entry.name for entry in islice(os.scandir(path.parent), 1000)]
    except (OSError, RuntimeError) as error:  # a name that is too long, a loop of links
        raise InvalidInputError(f"the file {quote(name)} cannot be found.") from error
    where = "" if Path(name).is_absolute() else f" in {show_path(folder)}"
    raise InvalidInputError(f"there is no file {quote(name)}{where}.{nearest(path.name, others)}")


class Entries(dict[str, Any]):
    """Values of settings by dotted name, whose errors name the line that they have in a file.

    Args:
        values: the values, which may be nested.
        document: the file.
        place: the entry that they stand under.
    """

    def __init__(self, values: Mapping[str, Any], document: Document, *place: str):
        super().__init__()
        for name, value in values.items():
            if isinstance(value, dict):
                self.update({f"{name}.{key}": entry for key, entry in value.items()})
            else:
                self[name] = value
        self._document, self._place = document, place

    @contextmanager
    def at(self, name: str) -> Iterator[None]:
        """Lets errors name the line of a value, or that of all where it has no name."""
        place: Place = (*self._place, name)
        if place not in self._document.lines:  # it stands there nested, or there is no name
            place = (*self._place, *filter(None, name.split(".")))
        with self._document.name_lines(), at_entry(*place):
            yield


def show_path(path: Path) -> str:
    """Returns a file's name with its folder, such as hopper/task.yaml, for a sentence."""
    name = "/".join(path.parts[-2:])
    return name if name.isprintable() and len(name) < 80 else quote(name)


def shorten(sentence: str) -> str:
    """Returns a sentence on one line; the middle of one that is too long is left out."""
    text = "".join(letter if letter.isprintable() else " " for letter in sentence)
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST_ERROR else f"{text[:350]} ... {text[-100:]}"


def _place_in_words(place: Place) -> str:
    """Returns a place as an error names it: `cost[0].sensor`."""
    text = ""
    for key in place:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            text += f".{key}" if len(key) <= 60 else f".{quote(key)}"
    return text.removeprefix(".")


def read_document(path: Path) -> Document:
    """Reads a YAML file whose top level is a mapping.

    Raises:
        InvalidInputError: the file cannot be read, or is no plain YAML.
    """
    document = Document(path, {}, {(): 1})
    text = _text(document)
    try:
        node = YAML(typ="safe", pure=True).compose(text)
        if node is None:
            raise document.error((), "the file is empty; it must begin with a key.")
        if not isinstance(node, MappingNode):
            sentence = "the file must hold keys with values, such as `horizon: 4.0`."
            raise document.error((), sentence)
        _note_lines(document, node, ())
        document.data.update(_given(YAML(typ="safe", pure=True).load(text)))
    except InvalidInputError:
        raise
    except MarkedYAMLError as error:
        mark, hint = error.problem_mark or error.context_mark, ""
        if isinstance(error, ScannerError | ParserError):
            hint = "; check the indentation, the brackets, and the colon and space behind each key"
        sentence = f"this is no plain YAML, {error.problem or error.context}{hint}."
        raise document.error_at(mark.line + 1 if mark else 1, sentence) from error
    except RecursionError as error:
        raise document.error((), "the values are nested too deeply.") from error
    except (YAMLError, ValueError, OverflowError, TypeError) as error:
        raise document.error((), f"this is no plain YAML: {error}.") from error
    return document


def _text(document: Document) -> str:
    """Returns the file's text."""
    path = document.path
    try:
        data = b""
        if is_there := path.is_file():
            with path.open("rb") as file:
                data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"The file {show_path(path)} cannot be read: {error}.") from error
    if not is_there:
        raise InvalidInputError(f"There is no file {quote(str(path))}; name a YAML file.")
    if len(data) > LARGEST_FILE:
        raise document.error((), f"the file is larger than {LARGEST_FILE} bytes; make it shorter.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise document.error_at(
            line, "the text is not in UTF-8; save the file as UTF-8."
        ) from error


def _note_lines(document: Document, node: Node, place: Place) -> None:
    """Notes the line of each entry, and refuses anchors and texts that do not print."""
    document.lines[place] = node.start_mark.line + 1 if place else 1
    if node.anchor:
        raise document.error(place, "anchors (&) are not read; write the value out.")
    if isinstance(node, ScalarNode) and not node.value.isprintable():
        raise document.error(
            place, f"the text {quote(node.value)} must stand on one line, in letters that print."
        )
    if isinstance(node, SequenceNode):
        for i, entry in enumerate(node.value):
            _note_lines(document, entry, (*place, i))
    elif isinstance(node, MappingNode):
        for key, entry in node.value:
            if not isinstance(key, ScalarNode) or key.anchor or not key.value.isprintable():
                raise document.error_at(
                    key.start_mark.line + 1, "a key must be a plain text, such as `horizon: 4.0`."
                )
            here, line = (*place, key.value), key.start_mark.line + 1
            if here in document.lines:
                sentence = f"the key stands twice, here and in line {line}; leave one of them out."
                raise document.error(here, sentence)
            _note_lines(document, entry, here)
            document.lines[here] = line


def _given(value: Any) -> Any:
    """Returns a value without the keys that have no value."""
    if isinstance(value, dict):
        return {str(key): _given(entry) for key, entry in value.items() if entry is not None}
    return [_given(entry) for entry in value] if isinstance(value, list) else value


def as_record(document: Document, kind: type[R]) -> R:
    """Returns a document's data as a record.

    Raises:
        InvalidInputError: an entry does not fit; the sentence says which, and what would fit.
    """
    try:
        return msgspec.convert(document.data, kind)
    except msgspec.ValidationError as error:
        raise document.error(*_explain(document.data, kind, str(error))) from error


def _explain(data: Any, kind: type[R], error: str) -> tuple[Place, str]:
    """Returns the place of the entry that msgspec complains about, and a sentence on it."""
    complaint, _, path = error.partition(" - at `")
    place, value = _entry(data, kind, path.rstrip("`"), error)
    schemas, hint = _schemas(kind, data, place)
    known = list(dict.fromkeys(key for each in schemas for key in each.get("properties", {})))
    if found := re.fullmatch("Object contains unknown field `(.*)`", complaint, re.S):
        return (*place, found[1]), (
            f"{quote(found[1])} is no key here; the keys are {', '.join(known)}."
            f"{nearest(found[1], known)}"
        )
    if found := re.fullmatch("Object missing required field `(.*)`", complaint, re.S):
        _, hint = _schemas(kind, data, (*place, found[1]))
        return place, f"the key {quote(found[1])} is missing{hint}."
    if path.startswith("key` in"):
        names = {"type": "string", **schemas[0]["propertyNames"]}
        key = next(k for k in value if not names["minLength"] <= len(k) <= names["maxLength"])
        return (*place, key), wrong_value("the key", key, [names], hint)
    return place, wrong_value("it", value, schemas, hint)


def _entry(data: Any, kind: type[R], path: str, error: str) -> tuple[Place, Any]:
    """Returns the place and the value of an entry of which msgspec has the path, as `.cost[0]`."""
    place: Place = ()
    value = data
    for name, number in re.findall(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]", path):
        if number == "...":  # some key of a mapping: the first that has the error by itself
            keys = [one for one in value if _complaint(data, kind, place, one) == error]
            key = (keys or list(value))[0]
        else:
            key = name or int(number)
        place, value = (*place, key), value[key]
    return place, value


def _complaint(data: Any, kind: type[R], place: Place, key: str) -> str:
    """Returns what msgspec says of the data if the mapping at a place has only this key."""
    data = inner = deepcopy(data)
    for each in place:
        inner = inner[each]
    for other in set(inner) - {key}:
        del inner[other]
    try:
        msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        return str(error)
    return ""


def _schemas(kind: type[R], data: Any, place: Place) -> tuple[list[dict[str, Any]], str]:
    """Returns the JSON schemas that an entry may fit, and the hint of the field around it."""
    root: dict[str, Any] = _schema_of(kind)
    schemas, hint = _alternatives(root, root, data), ""
    for key in place:
        data = data.get(key) if isinstance(data, dict) else data[key]
        inner = [found for each in schemas if (found := _part(each, key)) is not None]
        hint = next((_hint(key, each) for each in inner if "description" in each), hint)
        schemas = [one for each in inner for one in _alternatives(root, each, data)]
    return schemas, hint


@lru_cache
def _schema_of(kind: type[R]) -> dict[str, Any]:
    return msgspec.json.schema(kind)


def _alternatives(root: Any, schema: Any, value: Any) -> list[dict[str, Any]]:
    """Returns the schemas of a union, or those that a record's tag picks."""
    if "discriminator" in schema and isinstance(value, dict):
        choice = schema["discriminator"]
        tag = value.get(choice["propertyName"])
        if isinstance(tag, str) and tag in choice["mapping"]:
            schema = {"$ref": choice["mapping"][tag]}
    if "$ref" in schema:
        return _alternatives(root, root["$defs"][schema["$ref"].rpartition("/")[2]], value)
    if "anyOf" in schema:
        return [one for each in schema["anyOf"] for one in _alternatives(root, each, value)]
    return [schema]


def _part(schema: dict[str, Any], key: str | int) -> Any:
    """Returns the schema of an entry of a mapping or list; None if there is none."""
    if isinstance(key, int):
        return [*schema.get("prefixItems", ()), *[schema.get("items") or None] * (key + 1)][key]
    return schema.get("properties", {}).get(key, schema.get("additionalProperties") or None)


def _hint(key: str | int, schema: dict[str, Any]) -> str:
    """Returns a field's description and example as the end of a sentence."""
    example = json.dumps(schema["examples"][0], ensure_ascii=False) if "examples" in schema else ""
    return f": {schema['description']}" + (f"; for example `{key}: {example}`" if example else "")


def read_task_file(path: Path) -> tuple[TaskFile, Document]:
    """Reads a task file, and checks all that needs no model.

    Args:
        path: the file, or a folder with a `task.yaml`.

    Returns:
        The task, and the document, which knows the line of each entry for later errors.

    Raises:
        InvalidInputError: the file cannot be read, or an entry is wrong.
    """
    document = read_document(path / "task.yaml" if os.path.isdir(path) else path)
    task = as_record(document, TaskFile)
    with document.name_lines():
        _check(task, document.data, document.folder)
        find_model(task.model, document.folder)
    settings_in(task, document)
    return task, document


def settings_in(task: TaskFile, document: Document) -> tuple[OptimizerSettings, Entries]:
    """Returns the settings of the optimizer, and those of a search, whose values it checks itself.

    Raises:
        InvalidInputError: one of them is unknown, or one of the optimizer's is out of range.
    """
    optimizer = Entries(task.optimizer, document, "optimizer")
    search = Entries(task.search, document, "search")
    for name in search:
        with search.at(name):
            one_of("setting", name, _search_names())
    return with_values(OptimizerSettings(), optimizer), search


@lru_cache
def _search_names() -> list[str]:
    """Returns the names of a search's settings, which is below this room, by the JSON schema."""
    of_task = json.loads(SCHEMA_PATH.read_text())["$defs"]["TaskFile"]["properties"]
    keys = of_task["search"]["properties"]
    return [name for name, key in keys.items() if key["type"] != "object"]


def find_model(reference: str, folder: Path) -> Path:
    """Returns the path of the model that a task file in a folder names.

    `package://PACKAGE/PATH` is a file of a Python package, which is not imported, or of the shared
    folder of a ROS package.

    Raises:
        InvalidEntryError: there is no such package or file.
    """
    with at_entry("model"):
        if not reference.startswith("package:"):
            return _existing_file(folder, reference)
        found = _PACKAGE.fullmatch(reference)
        if not found or ".." in Path(found[2]).parts:
            raise InvalidInputError(
                f"it is {quote(reference)}, but it must be package://PACKAGE/PATH inside a package."
            )
        folders = package_folders(found[1])
        refuse_if(
            not folders,
            f"there is no package {found[1]}, neither of Python nor in AMENT_PREFIX_PATH; install "
            "it, or source its workspace.",
        )
        existing = (folder for folder in folders if (folder / found[2]).is_file())
        return _existing_file(next(existing, folders[0]), found[2])


def _check(task: TaskFile, given: Mapping[str, Any], folder: Path) -> None:
    """Checks a task, of which the data of its file are given.

    Raises:
        InvalidEntryError: an entry contradicts another, or names a file outside the folder.
    """
    _check_times(task)
    for name, sensor in task.sensors.items():
        with at_entry("sensors", name):
            _check_sensor(name, sensor)
    for name, command in task.commands.items():
        with at_entry("commands", name):
            _check_command(name, command, task.commands)
    for i, term in enumerate(task.cost):
        with at_entry("cost", i):
            _check_term(term, given["cost"][i])
    for i, entry in enumerate(task.observe):
        if isinstance(entry, ObservedEntry):
            with at_entry("observe", i):
                _check_observation(entry, given["observe"][i])
    for key, limits in (("fallen", task.fallen), ("limits", task.limits)):
        for i, limit in enumerate(limits):
            with at_entry(key, i):
                _check_one_of(limit, ("below", "above", "beyond"))
    with at_entry("begin"):
        _check_begin(task.begin, given.get("begin", {}), folder)


def _check_command(name: str, command: CommandEntry, commands: Mapping[str, CommandEntry]) -> None:
    low, high = command.range
    refuse_if(
        not low < high,
        f"it is {low:g} to {high:g}, but the second must be larger than the first.",
        "range",
    )
    refuse_if(
        "/" in name or (command.source is not None and not SOURCE.fullmatch(command.source)),
        "its name must hold no slash, and `from` must be cmd_vel/linear/x, or another field of a "
        "Twist: linear or angular, x, y or z.",
    )
    same = next((other for other, c in commands.items() if c.source == command.source), name)
    refuse_if(
        command.source is not None and same != name,
        f"{same} comes from {command.source} already; each command needs a field of its own.",
        "from",
    )


def _check_begin(begin: Begin, given: Mapping[str, Any], folder: Path) -> None:
    if isinstance(begin, RecordedMotion | PathMotion) and begin.file is not None:
        with at_entry("file"):
            file_inside(folder, begin.file)
    refuse_if(
        isinstance(begin, Sampling) and begin.std is not None and "noise" in given,
        "it is a share of the controls' range, for which std stands; leave one of them out.",
        "noise",
    )


def is_multiple(time: float, unit: float) -> bool:
    """Returns whether a time is a whole multiple of a unit, apart from rounding."""
    ratio = time / unit
    return isfinite(ratio) and abs(ratio - round(ratio)) <= _ROUNDING * min(1.0, ratio)


def _check_times(task: TaskFile) -> None:
    period, step = task.control_period, task.changes.option.timestep
    refuse_if(
        step is not None and not is_multiple(period, step),
        f"it is {period:g} s, but it must be a multiple of the simulator's time step, {step} s.",
        "control_period",
    )
    if (clock := task.clock) is not None:
        fastest = 0.5 / period
        refuse_if(
            clock.frequency > fastest,
            f"it is {clock.frequency:g} Hz, but with a control_period of {period:g} s it must be "
            f"at most {fastest:g} Hz, two controls a turn.",
            "clock",
            "frequency",
        )
        refuse_if(
            clock.stops and not task.commands,
            "the clock would never turn, since the task has no commands that could be other than "
            "at rest; add one, or leave it out.",
            "clock",
            "stops",
        )
    steps = round((task.horizon + task.lookahead) / period)
    refuse_if(
        steps > MOST_STEPS,
        f"horizon and lookahead have {steps:g} steps, but at most {MOST_STEPS} are taken.",
        "horizon",
    )


def _check_term(term: CostTerm, given: Mapping[str, Any]) -> None:
    """Checks a term of the cost."""
    _check_one_of(term, ("sensor", "control"))
    if term.sensor is None:
        for key in _OF_SENSORS:
            refuse_if(
                key in given,
                "this belongs to a term with a sensor; a term of controls has a weight only.",
                key,
            )
        names = (term.control,) if isinstance(term.control, str) else term.control or ()
        for i, name in enumerate(names):
            refuse_if(
                name in names[:i], "this entry stands twice; leave one of them out.", "control", i
            )
    refuse_if(
        "width" in given and term.norm != "smooth_abs",
        "only smooth_abs has a width; add `norm: smooth_abs`.",
        "width",
    )
    refuse_if(
        term.pose is not None and term.control is None,
        "only a term of controls has a pose; leave it out.",
        "pose",
    )
    several = isinstance(term.target, tuple)
    for i, target in enumerate(term.target if isinstance(term.target, tuple) else (term.target,)):
        if isinstance(target, Followed):
            own = given["target"][i] if several else given["target"]
            with at_entry("target", *((i,) if several else ())):
                _check_one_of(target, ("command", "swing"))
                refuse_if(
                    target.swing is None and "phase" in own,
                    "only a swing has a phase; leave it out.",
                    "phase",
                )


def _check_observation(entry: ObservedEntry, given: Mapping[str, Any]) -> None:
    _check_one_of(entry, ("joint", "sensor", "joint_positions", "joint_velocities"))
    for key, owner in (("as", "joint"), ("index", "sensor")):
        refuse_if(
            key in given and getattr(entry, owner) is None,
            f"this belongs beside {owner}; leave it out here.",
            key,
        )


def _check_sensor(name: str, sensor: Sensor) -> None:
    """Checks that an added sensor has a type of MuJoCo's, and the objects that it needs."""
    what = f"a {sensor.type}"
    refuse_if(
        sensor.type not in SENSOR_TYPES,
        f"{quote(sensor.type)} is no type of sensor; there are {list_names(list(SENSOR_TYPES))}."
        f"{nearest(sensor.type, SENSOR_TYPES)}",
        "type",
    )
    refuse_if("/" in name, "a sensor's name must not hold a slash; rename it.")
    kind = SENSOR_TYPES[sensor.type]
    between = kind.mujoco_name.startswith("geom")
    _check_object(sensor, kind.objects, what)
    if sensor.relative_to is not None:
        with at_entry("relative_to"):
            refuse_if(not kind.relative_to, f"{what} measures relative to nothing; leave it out.")
            _check_object(sensor.relative_to, kind.relative_to, what)
    refuse_if(
        between and (sensor.relative_to is None or sensor.cutoff is None),
        f"{what} needs relative_to and cutoff, the farthest distance seen [m], for example "
        "`relative_to: {geom: wall}, cutoff: 1.0`.",
    )


def _check_object(record: Record, kinds: Sequence[str], what: str) -> None:
    """Checks that a record names one object, of a kind that fits."""
    allowed = f"one of {', '.join(kinds)}" if kinds else "nothing, since it is of the whole model"
    for kind in OBJECTS:
        refuse_if(
            getattr(record, kind, None) is not None and kind not in kinds,
            f"{what} may name {allowed}, but not {kind}.",
            kind,
        )
    if kinds:
        _check_one_of(record, kinds)


def _check_one_of(record: Record, names: Sequence[str]) -> None:
    """Checks that a record has a value for exactly one of some fields."""
    given = [name for name in names if getattr(record, name) is not None]
    refuse_if(
        len(given) != 1,
        f"exactly one of {', '.join(names)} must be given, but here is "
        f"{' and '.join(given) or 'none'}.",
    )
