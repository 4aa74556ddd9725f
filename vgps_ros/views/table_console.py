# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Opens the console on which programs print their tables.

Names, paths and units come from outside, so nothing in what is printed is markup: of `a[/b]` or
`[m, rad]` no letter is taken for a style. What needs a style gets it beside the text.
"""

from rich.console import Console

_WIDE = 140  # characters; more than any table needs


def plain_console() -> Console:
    """Returns a console on the standard output that prints each text as it is."""
    return Console(markup=False, emoji=False)


def table_console(*, wide: bool = False) -> Console:
    """Returns a plain console that is wide enough for tables.

    It is as wide as the terminal. Without a terminal, rich would assume 80 characters and cut the
    tables, so the console is then as wide as any table needs.

    Args:
        wide: whether to take the full width on a narrow terminal too, which then breaks the lines.
    """
    console = plain_console()
    if wide or not console.is_terminal:
        console.width = max(console.width, _WIDE)
    return console
