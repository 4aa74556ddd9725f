# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes the JSON schema of task files, by which editors complete and check them, and their page.

Run it in the repository's root after a change of `vgps_ros/tasks/schema.py`, or of a setting of a
search or of the optimizer:

    python scripts/write_task_schema.py
"""

import json
import re
from inspect import cleandoc
from pathlib import Path
from typing import Any

import msgspec
import yaml

from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import settings_of
from vgps_ros.search.settings import SearchSettings
from vgps_ros.tasks.schema import TaskFile
from vgps_ros.tasks.task_file import SCHEMA_PATH

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "task_file.md"
_BLOCK = re.compile(r"(<!-- keys: .*? -->\n).*?(<!-- end of keys -->)", re.S)


def definition() -> str:
    """Returns the text of the schema."""
    schema: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$comment": "Written by scripts/write_task_schema.py from schema.py; do not edit.",
        **_finite(msgspec.json.schema(TaskFile)),
    }
    keys = schema["$defs"]["TaskFile"]["properties"]
    keys["search"] |= _keys_of(SearchSettings())
    keys["optimizer"] |= _keys_of(OptimizerSettings())
    return json.dumps(schema, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _keys_of(record: Any) -> dict[str, Any]:
    """Returns the schema of a mapping of a record's settings, by dotted names or nested."""
    keys: dict[str, Any] = {}
    for each in settings_of(record):
        of_list = {"type": "array", "items": each.schema, "minItems": 1}
        found = {"description": each.description, **(of_list if each.is_list else each.schema)}
        keys[each.name] = found | {"default": each.default}
        group, _, name = each.name.rpartition(".")
        if group:
            inner = {"type": "object", "properties": {}, "additionalProperties": False}
            keys.setdefault(group, inner)["properties"][name] = keys[each.name]
    return {"properties": keys, "additionalProperties": False}


def _finite(value: Any) -> Any:
    """Returns a schema without defaults of infinity, which JSON cannot hold."""
    if isinstance(value, dict):
        kept = {key: entry for key, entry in value.items() if entry != float("inf")}
        return {key: _finite(entry) for key, entry in kept.items()}
    return [_finite(entry) for entry in value] if isinstance(value, list | tuple) else value


def page(text: str) -> str:
    """Returns the page of task files with its tables of keys."""
    records = msgspec.json.schema(TaskFile)["$defs"]
    places: dict[str, list[str]] = {"TaskFile": ["The whole file"]}
    _find_places(records, "TaskFile", "", places)
    tables = [_table(", ".join(places[name]), records[name]) for name in places]
    return _BLOCK.sub(lambda found: f"{found[1]}\n{chr(10).join(tables)}{found[2]}", text)


def _find_places(
    records: dict[str, Any], name: str, prefix: str, places: dict[str, list[str]]
) -> None:
    """Finds under which keys each record stands, such as start.std, in the file's order."""
    for key, value in records[name]["properties"].items():
        for inner in dict.fromkeys(re.findall(r"#/\$defs/(\w+)", json.dumps(value))):
            law = records[inner]["properties"].get("law")
            place = f"{prefix}{key}" + (f" with law {law['enum'][0]}" if law else "")
            places.setdefault(inner, []).append(place)
            if len(places[inner]) == 1:
                _find_places(records, inner, f"{place}.", places)


def _table(title: str, record: dict[str, Any]) -> str:
    rows = [f"### {title}", "", cleandoc(record["description"]), ""]
    rows += ["| key | meaning | default | example |", "| --- | --- | --- | --- |"]
    for key, value in record["properties"].items():
        if key == "law":
            rows.append(f"| `law` | must be `{value['enum'][0]}` | | |")
            continue
        required = key in record.get("required", ())
        default = "must be given" if required else _shown(value.get("default"))
        example = next(iter(value.get("examples", ())), None)
        text = value.get("description", "").replace("|", "\\|")
        rows.append(f"| `{key}` | {text} | {default} | {_shown(example)} |")
    return "\n".join([*rows, "", ""])


def _shown(value: Any) -> str:
    """Returns a value as YAML has it; nothing for one that is left out or empty."""
    if value is None or value in ({}, [], ""):
        return ""
    if value == float("inf"):
        return "`.inf`"
    text = yaml.safe_dump(value, default_flow_style=True, width=1000, sort_keys=False)
    return f"`{text.removesuffix(chr(10)).removesuffix('...').strip()}`"


if __name__ == "__main__":
    SCHEMA_PATH.write_text(definition())
    PAGE.write_text(page(PAGE.read_text()))
    print(f"Wrote {SCHEMA_PATH} and {PAGE}.")
