"""Record what a terminal shows of the first commands as docs/images/terminal.svg.

./koop shell -c 'python scripts/terminal.py'
"""

from __future__ import annotations

import os
import pty
import re
import subprocess
import tempfile
from pathlib import Path

from rich.console import Console
from rich.text import Text

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "terminal.svg"
COLUMNS = 100
SESSION = ("./koop demo --out first", "./koop replay first")


def run(command: str, folder: str) -> Text:
    """Return what a command of the repository shows in a terminal, without what it wrote over."""
    ours, terminal = pty.openpty()
    environment = os.environ | {"COLUMNS": str(COLUMNS), "TERM": "xterm-256color"}
    words = [str(ROOT / "koop"), *command.split()[1:]]
    with subprocess.Popen(
        words, cwd=folder, env=environment, stdin=terminal, stdout=terminal, stderr=terminal
    ):
        os.close(terminal)
        shown = b""
        while part := read(ours):
            shown += part
    lines = shown.decode().replace("\r\n", "\n").split("\n")
    return Text.from_ansi("\n".join(re.sub(r".*\r", "", line) for line in lines))


def read(terminal: int) -> bytes:
    """Return what a terminal shows next, nothing at its end."""
    try:
        return os.read(terminal, 65536)
    except OSError:  # the program has closed its side
        return b""


console = Console(record=True, width=COLUMNS, highlight=False)
with tempfile.TemporaryDirectory() as folder:
    for command in SESSION:
        console.print(f"[bold green]$[/] [bold]{command}[/]", run(command, folder), sep="\n")
svg = console.export_svg(title="koop", unique_id="terminal")
PICTURE.write_text(re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL))  # from elsewhere
