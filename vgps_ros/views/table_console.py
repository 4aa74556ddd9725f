# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Opens the console on which programs print their tables."""

from rich.console import Console

_WIDE = 140  # characters; more than any table needs


def table_console(*, wide: bool = False) -> Console:
    """Returns a console on the standard output that is wide enough for tables.

    It is as wide as the terminal. Without a terminal, rich would assume 80 characters and cut the
    tables, so the console is then as wide as any table needs.

    Args:
        wide: whether to take the full width on a narrow terminal too, which then breaks the lines.
    """
    console = Console()
    if wide or not console.is_terminal:
        console.width = max(console.width, _WIDE)
    return console
