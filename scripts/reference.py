"""Write docs/reference/commands.md and parameters.md from the code that they describe.

    ./koop shell -c 'python scripts/reference.py'

``tests/architecture/test_docs.py`` fails where the files differ from what is generated here.
"""

from __future__ import annotations

import argparse
import re
import textwrap
from dataclasses import Field
from pathlib import Path
from typing import Any, NamedTuple

from koop_bag.player.config import PlayerConfig
from koop_bag.recorder.config import RECORDER
from koop_core.config.describe import parameters_of
from koop_core.config.parameter import NodeConfig, spec_of
from koop_core.config.parameter_file import as_yaml
from koop_guard.config import GUARD
from koop_lab.cli.main import overview, parser
from koop_loop.parameters import NODES
from koop_tune.rig.rig_file import RigFile

ROOT = Path(__file__).resolve().parents[1]
WIDTH = 100
FEW = 25  # characters that an option's choices may have to stand beside it
COMMON = {"every node": (NodeConfig,)}
LOOP = {
    "koopman_lifter": NODES["koopman_lifter"],
    "relay_esc": NODES["relay_esc"],
    **GUARD,
    **RECORDER,
}
OTHERS = {
    "vdp_plant": NODES["vdp_plant"],
    "player": (PlayerConfig,),
}


class Command(NamedTuple):
    """A command without subcommands, and what it does."""

    parser: argparse.ArgumentParser
    summary: str

    @property
    def options(self) -> list[argparse.Action]:
        """The options, without --help."""
        return [a for a in self.parser._actions if a.option_strings and a.dest != "help"]

    @property
    def arguments(self) -> str:
        """The positional arguments, as the usage shows them."""
        few = {"?": "[{}]", "*": "[{}...]", "+": "{}..."}
        return " ".join(
            few.get(str(a.nargs), "{}").format(a.metavar or a.dest.upper())
            for a in self.parser._actions
            if not a.option_strings
        )


def commands(
    root: argparse.ArgumentParser, name: str = "", summary: str = ""
) -> dict[str, Command]:
    """Return every command below a parser, by its words."""
    below = [a for a in root._actions if isinstance(a, argparse._SubParsersAction)]
    if not below:
        return {name: Command(root, summary)}
    helps = {action.dest: action.help or "" for action in below[0]._choices_actions}
    return {
        words: command
        for word, sub in below[0].choices.items()
        for words, command in commands(sub, f"{name} {word}".strip(), helps.get(word, "")).items()
    }


def workspace_commands() -> list[tuple[str, str]]:
    """Return what ./koop itself brings, from its usage: words and meaning."""
    text = (ROOT / "koop").read_text(encoding="utf-8")
    block = text.split("\nworkspace\n")[1].split("\n\n")[0]
    return re.findall(r"^  (\w+(?: \[?[A-Z]+\]?)*) +(.+)$", block, re.MULTILINE)


def own_parameters(node: str) -> list[Field[Any]]:
    """Return the parameters of a node, without those that every node or the rig file has."""
    items = parameters_of((COMMON | LOOP | OTHERS)[node])
    others = set(() if node in COMMON else NodeConfig.__dataclass_fields__)
    if node in GUARD:
        others |= RigFile.__dataclass_fields__.keys()
    return [item for item in items if item.name not in others]


def counts() -> dict[str, int]:
    """Return how many commands, options and parameters of a rig's loop there are."""
    found = commands(parser())
    return {
        "commands": len(found) + len(workspace_commands()),
        "options": sum(len(command.options) for command in found.values()),
        "parameters": len({p.name for node in COMMON | LOOP for p in own_parameters(node)}),
    }


def shortened(text: str, room: int) -> str:
    """Return a text, or as many of its first clauses as fit."""
    text = " ".join(text.replace("%%", "%").replace("|", "\\|").split())
    if len(text) <= room:
        return text
    ends = [match.start() for match in re.finditer(r"[;:.,] | \(", text)]
    fitting = [
        end
        for end in ends
        if room // 3 < end <= room and text.count("(", 0, end) == text.count(")", 0, end)
    ]
    return text[: fitting[-1]] if fitting else textwrap.shorten(text, room, placeholder=" …")


def row(cell: str, text: str) -> str:
    """Return a row of a table that is not wider than the page."""
    return f"| {cell} | {shortened(text, WIDTH - 7 - len(cell))} |"


def flag(action: argparse.Action) -> str:
    """Return an option with its choices or the name of its value."""
    text = max(action.option_strings, key=len)
    if action.nargs == 0:
        return text
    choices = "\\|".join(map(str, action.choices or ()))
    if choices and not action.metavar and len(choices) <= FEW:
        return f"{text} {choices}"
    return f"{text} {action.metavar or action.dest.upper()}"


def commands_page() -> str:
    """Return docs/reference/commands.md."""
    found, count = commands(parser()), counts()
    head = (
        f"{count['commands']} commands with {count['options']} options, written by "
        "`scripts/reference.py`. `./koop COMMAND --help` has every word."
    )
    lines = ["# Commands", "", *textwrap.wrap(head, WIDTH), "", "| | |", "|---|---|"]
    for block in overview().strip().split("\n\n"):
        title, *listed = block.splitlines()
        lines.append(f"| **{title.capitalize()}** | |")
        for word, summary in (line.split(maxsplit=1) for line in listed):
            for name, command in found.items():
                if name.split()[0] == word:
                    lines += command_rows(name, command, command.summary or summary)
    lines.append("| **Workspace** | |")
    lines += [row(f"**`koop {words}`**", meaning) for words, meaning in workspace_commands()]
    return "\n".join(lines) + "\n"


def command_rows(name: str, command: Command, summary: str) -> list[str]:
    """Return the rows of a command and its options."""
    lines = [row(f"**`koop {f'{name} {command.arguments}'.strip()}`**", summary)]
    return lines + [row(f"`{flag(option)}`", option.help or "") for option in command.options]


def parameters_page() -> str:
    """Return docs/reference/parameters.md."""
    head = (
        f"A rig's loop has {counts()['parameters']} parameters; the guard also has what the rig "
        "file says: topics, limits, rate, theta_safe. Written by `scripts/reference.py`; `./koop "
        "params` and `--help` of a node have ranges and every "
        "word. (f): fixed while the node runs."
    )
    lines = ["# Parameters", "", *textwrap.wrap(head, WIDTH), "", "| name: default | meaning |"]
    lines.append("|---|---|")
    for node in COMMON | LOOP:
        lines.append(f"| **{node}** | |")
        for item in own_parameters(node):
            fixed = " (f)" if spec_of(item).read_only else ""
            lines.append(row(default_of(item) + fixed, spec_of(item).description))
    for node in OTHERS:
        names = ", ".join(default_of(item, "=") for item in own_parameters(node))
        lines += ["", *textwrap.wrap(f"**{node}**: {names}.", WIDTH)]
    return "\n".join(lines) + "\n"


def default_of(item: Field[Any], between: str = ": ") -> str:
    """Return name, default and unit of a parameter."""
    value = f"{item.default:.4g}" if isinstance(item.default, float) else as_yaml(item.default)
    unit = spec_of(item).unit
    return f"`{item.name}{between}{value}`" + (f" {unit}" if unit else "")


PAGES = {
    ROOT / "docs/reference/commands.md": commands_page,
    ROOT / "docs/reference/parameters.md": parameters_page,
}


def main() -> None:
    """Write the pages."""
    for path, page in PAGES.items():
        path.write_text(page(), encoding="utf-8")
        print(f"written: {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
