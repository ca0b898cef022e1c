"""Write docs/reference/commands.md and parameters.md from the code that they describe.

    ./koop shell -c 'python scripts/reference.py'

``tests/architecture/test_reference.py`` fails where the files differ from what is generated here.
"""

from __future__ import annotations

import argparse
import re
import textwrap
from collections import Counter
from collections.abc import Iterator
from dataclasses import Field
from pathlib import Path
from typing import Any

from koop_bag.player.config import PlayerConfig
from koop_bag.recorder.config import RecorderConfig
from koop_core.config.describe import parameters_of
from koop_core.config.parameter import NodeConfig, spec_of
from koop_core.config.parameter_file import as_yaml
from koop_lab.cli.main import overview, parser
from koop_loop.parameters import NODES
from koop_view.config import ViewConfig

ROOT = Path(__file__).resolve().parents[1]
WIDTH = 100
SHARED = 3  # commands that an option with the same words must have to be listed once for all
FEW = 25  # characters that an option's choices may have to stand beside it
COMMON = {"every node": (NodeConfig,)}
LOOP = {
    "koopman_lifter": NODES["koopman_lifter"],
    "relay_esc": NODES["relay_esc"],
    "recorder": (RecorderConfig,),
}
OTHERS = {
    "vdp_plant": NODES["vdp_plant"],
    "player": (PlayerConfig,),
    "server": (ViewConfig,),
}
Commands = dict[str, argparse.ArgumentParser]


def leaves(root: argparse.ArgumentParser, name: str = "") -> Commands:
    """Return the parser of every command that has no subcommands, by its name."""
    below = [a for a in root._actions if isinstance(a, argparse._SubParsersAction)]
    if not below:
        return {name: root}
    return {
        leaf: made
        for word, sub in below[0].choices.items()
        for leaf, made in leaves(sub, f"{name} {word}".strip()).items()
    }


def options(command: argparse.ArgumentParser) -> list[argparse.Action]:
    """Return the options of a command, without --help."""
    return [a for a in command._actions if a.option_strings and a.dest != "help"]


def scripts_own() -> dict[str, str]:
    """Return what ./koop itself brings, from its usage: word and meaning."""
    text = (ROOT / "koop").read_text(encoding="utf-8")
    block = text.split("\nworkspace\n")[1].split("\n\n")[0]
    return {
        " ".join(words.split()): meaning
        for words, meaning in re.findall(r"^  (\w+(?: \[?[A-Z]+\]?)*) +(.+)$", block, re.MULTILINE)
    }


def shortened(text: str, room: int) -> str:
    """Return a text, or as many of its first clauses as fit."""
    text = " ".join(text.replace("%%", "%").replace("|", "\\|").split())
    if len(text) <= room:
        return text
    ends = [m.start() for m in re.finditer(r"[;:.,] | \(", text)]
    fitting = [e for e in ends if room // 3 < e <= room and balanced(text[:e])]
    return text[: fitting[-1]] if fitting else textwrap.shorten(text, room, placeholder=" …")


def balanced(text: str) -> bool:
    """Return whether a text closes every bracket that it opens."""
    return text.count("(") == text.count(")")


def row(cell: str, text: str) -> str:
    """Return a row of a table that is not wider than the page."""
    return f"| {cell} | {shortened(text, WIDTH - 7 - len(cell))} |"


def flag(action: argparse.Action) -> str:
    """Return an option with the name of its value."""
    text = max(action.option_strings, key=len)
    if action.nargs == 0:
        return text
    choices = "|".join(map(str, action.choices or ()))
    if choices and not action.metavar and len(choices) <= FEW:
        return f"{text} {choices}".replace("|", "\\|")
    return f"{text} {action.metavar or action.dest.upper()}"


def positionals(command: argparse.ArgumentParser) -> str:
    """Return the positional arguments of a command, as its usage shows them."""
    words = []
    for action in command._actions:
        if not action.option_strings:
            name = action.metavar or action.dest.upper()
            few = {"?": f"[{name}]", "*": f"[{name}...]", "+": f"{name}..."}
            words.append(few.get(str(action.nargs), str(name)))
    return " ".join(words)


def summaries(root: argparse.ArgumentParser, name: str = "") -> dict[str, str]:
    """Return what each command does, in a line."""
    texts: dict[str, str] = {}
    for action in root._actions:
        if isinstance(action, argparse._SubParsersAction):
            texts |= {f"{name} {c.dest}".strip(): c.help or "" for c in action._choices_actions}
            for word, sub in action.choices.items():
                texts |= summaries(sub, f"{name} {word}".strip())
    return texts


def commands_page() -> str:
    """Return docs/reference/commands.md."""
    root = parser()
    commands = leaves(root)
    texts = summaries(root) | dict(re.findall(r"^  (\w+) +(.+)$", overview(), re.MULTILINE))
    uses = Counter((flag(o), o.help) for c in commands.values() for o in options(c))
    shared = {use for use, count in uses.items() if count >= SHARED}
    count, own = counts(), scripts_own()
    lines = [
        "# Commands",
        "",
        *textwrap.wrap(
            f"{count['commands']} commands with {count['options']} options, written by "
            "`scripts/reference.py`. `./koop COMMAND --help` has every word; options that several "
            "commands share are listed at the end.",
            WIDTH,
        ),
    ]
    for title, group in groups(commands):
        lines += ["", f"## {title}", "", "| command, option | meaning |", "|---|---|"]
        for name in group:
            command = commands[name]
            head = f"**`koop {' '.join(filter(None, (name, positionals(command))))}`**"
            lines.append(row(head, texts.get(name) or command.description or ""))
            also = []
            for option in options(command):
                if (flag(option), option.help) in shared:
                    also.append(f"`{max(option.option_strings, key=len)}`")
                else:
                    lines.append(row(f"`{flag(option)}`", option.help or ""))
            if also:
                lines.append(f"| | and {', '.join(also)} |")
    lines += ["", "## Workspace", "", "| command | meaning |", "|---|---|"]
    lines += [row(f"**`koop {words}`**", meaning) for words, meaning in own.items()]
    lines += ["", "## Options of several commands", "", "| option | meaning |", "|---|---|"]
    lines += [row(f"`{name}`", text or "") for name, text in sorted(shared, key=str)]
    return "\n".join(lines) + "\n"


def groups(commands: Commands) -> Iterator[tuple[str, list[str]]]:
    """Yield the groups of ./koop --help with their commands."""
    for block in overview().strip().split("\n\n"):
        title, *rows = block.splitlines()
        words = [line.split()[0] for line in rows]
        yield title.capitalize(), [n for w in words for n in commands if n.split()[0] == w]


def own_parameters(node: str) -> list[Field[Any]]:
    """Return the parameters of a node, without those that every node has."""
    items = parameters_of((COMMON | LOOP | OTHERS)[node])
    return [i for i in items if node in COMMON or i.name not in NodeConfig.__dataclass_fields__]


def counts() -> dict[str, int]:
    """Return how many commands, options and parameters of a rig's loop there are."""
    commands = leaves(parser())
    return {
        "commands": len(commands) + len(scripts_own()),
        "options": sum(len(options(command)) for command in commands.values()),
        "parameters": sum(len(own_parameters(node)) for node in COMMON | LOOP),
    }


def parameters_page() -> str:
    """Return docs/reference/parameters.md."""
    head = (
        f"The nodes of a rig's loop have {counts()['parameters']} parameters. Written by "
        "`scripts/reference.py`; `./koop params` and `--help` of a node have ranges and every "
        "word. (f): fixed while the node runs."
    )
    lines = ["# Parameters", "", *textwrap.wrap(head, WIDTH)]
    for node in COMMON | LOOP:
        title = node if node in COMMON else f"`{node}`"
        lines += ["", f"## {title[0].upper()}{title[1:]}", "", "| name: default | meaning |"]
        lines += ["|---|---|", *map(parameter_row, own_parameters(node))]
    lines += ["", "## Other nodes"]
    for node in OTHERS:
        names = ", ".join(default_of(item, "=") for item in own_parameters(node))
        lines += ["", *textwrap.wrap(f"`{node}`: {names}.", WIDTH)]
    return "\n".join(lines) + "\n"


def default_of(item: Field[Any], between: str = ": ") -> str:
    """Return name, default and unit of a parameter."""
    value = f"{item.default:.4g}" if isinstance(item.default, float) else as_yaml(item.default)
    unit = spec_of(item).unit
    return f"`{item.name}{between}{value}`" + (f" {unit}" if unit else "")


def parameter_row(item: Field[Any]) -> str:
    """Return the row of a parameter."""
    spec = spec_of(item)
    return row(default_of(item) + (" (f)" if spec.read_only else ""), spec.description)


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
