"""Where tables are printed."""

from rich.console import Console

_WIDE = 140  # characters; more than any table needs


def table_console(*, wide: bool = False) -> Console:
    """Returns the standard output: as wide as its terminal; without one, as wide as tables need.

    rich cuts what does not fit, and takes 80 characters where it knows no width.

    Args:
        wide: for tables that fit into no narrow terminal, which breaks their lines.
    """
    console = Console()
    if wide or not console.is_terminal:
        console.width = max(console.width, _WIDE)
    return console
