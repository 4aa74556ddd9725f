"""Writes the JSON schema of task files, by which editors complete and check them.

Run it in the repository's root after a change of `vgps_ros/tasks/task_schema.py` or
`vgps_ros/tasks/model_schema.py`:

    python scripts/write_task_schema.py
"""

import json
from typing import Any

import msgspec

from vgps_ros.tasks.task_file import SCHEMA_PATH
from vgps_ros.tasks.task_schema import TaskFile


def definition() -> str:
    """Returns the text of the schema."""
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$comment": "Written by scripts/write_task_schema.py from task_schema.py; do not edit.",
        **_finite(msgspec.json.schema(TaskFile)),
    }
    return json.dumps(schema, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    """Returns a schema without defaults of infinity, which JSON cannot hold."""
    if isinstance(value, dict):
        kept = {key: entry for key, entry in value.items() if entry != float("inf")}
        return {key: _finite(entry) for key, entry in kept.items()}
    return [_finite(entry) for entry in value] if isinstance(value, list | tuple) else value


if __name__ == "__main__":
    SCHEMA_PATH.write_text(definition())
    print(f"Wrote {SCHEMA_PATH}.")
