"""The command ``koop bag``: information, playing, recovery."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import Any

from koop_bag.errors import BagError
from koop_bag.player.config import PlayerConfig
from koop_core.config.parameter import spec_of

PLAY_OPTIONS = [item for item in dataclasses.fields(PlayerConfig) if item.name != "bag"]
"""Options of ``koop bag play``: parameters of the player."""


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    bag = bag_commands(commands)
    info = bag.add_parser("info", help="topics, rates, losses, model, parameters")
    info.add_argument("bag", help="folder, file, or URL such as s3://BUCKET/RUN")
    info.add_argument("--parameters", action="store_true", help="print the nodes' parameters, too")
    info.add_argument("--json", action="store_true", help="everything, for a program to read")
    info.set_defaults(func=_info)

    play = bag.add_parser("play", help="play a bag to other nodes")
    play.add_argument("bag", type=Path)
    for option in PLAY_OPTIONS:
        spec, default, name = spec_of(option), option.default, f"--{option.name}"
        text = spec.description + (f" [{spec.unit}]" if spec.unit else "")
        if isinstance(default, bool):
            play.add_argument(name, action="store_true", default=None, help=text)
            continue
        text += f" (default {default})" if default != "" else ""
        play.add_argument(name, type=type(default), metavar=option.name.upper(), help=text)
    play.set_defaults(func=_play)

    recover = bag.add_parser("recover", help="make a whole bag of a torn or damaged one")
    recover.add_argument("bag", type=Path)
    recover.add_argument("target", type=Path, nargs="?", help="default: beside it, _recovered")
    recover.set_defaults(func=_recover)


def bag_commands(commands: Any) -> Any:
    """Return the subparsers of ``koop bag``, for others to add theirs; made at the first call."""
    parser = commands.choices.get("bag")
    if parser is None:
        parser = commands.add_parser("bag")
        parser.nested = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    return parser.nested


def _info(args: argparse.Namespace) -> int:
    from koop_bag.bag.info import as_text, describe
    from koop_bag.bag.reader import BagReader

    with BagReader(args.bag) as reader:
        info = describe(reader)
    if args.json:
        print(json.dumps(dataclasses.asdict(info), indent=1, default=str))
    else:
        print(as_text(info, args.parameters))
    return 0


def _recover(args: argparse.Namespace) -> int:
    from koop_bag.bag.reader import BagReader
    from koop_bag.bag.recover import recover

    bag = args.bag.resolve()
    bag = bag / "bag" if (bag / "bag").is_dir() else bag
    target = args.target or bag.with_name(f"{bag.stem}_recovered")
    report = recover(args.bag, target)
    with BagReader(target) as reader:
        print(
            f"{target}: {report.messages} messages, {reader.duration:.3f} s; left out: "
            f"{report.damaged_records} damaged records, {report.torn_bytes} torn bytes at the end"
        )
    return 0


def _play(args: argparse.Namespace) -> int:
    """Become the player: signals and the exit code need no passing on."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        program = Path(get_package_prefix("koop_bag")) / "lib" / "koop_bag" / "player"
    except PackageNotFoundError:
        raise BagError("the package koop_bag is not built: run './koop setup'") from None
    sys.stdout.flush()
    os.execv(program, [str(program), *player_arguments(args)])


def player_arguments(args: argparse.Namespace) -> list[str]:
    """Return the options as ROS arguments of the player."""
    values = {"bag": str(args.bag)}
    values |= {item.name: getattr(args, item.name) for item in PLAY_OPTIONS}
    words = ["--ros-args"]
    for name, value in values.items():
        if value is not None:
            # in YAML, which parameters are written in, only quoted text is always text
            text = json.dumps(value, ensure_ascii=False)
            words += ["-p", f"{name}:={text}"]
    return words
