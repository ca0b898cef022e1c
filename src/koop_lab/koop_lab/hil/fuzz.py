"""``koop fuzz``: arbitrary bytes into everything that reads files or text from outside.

An input either works or is refused with the reader's own error; anything else is a finding. Time
per input and memory growth are measured too.
"""

from __future__ import annotations

import argparse
import math
import random
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from koop_bag.columns import read_columns
from koop_bag.config import RecorderConfig
from koop_bag.errors import BagError
from koop_bag.reader import BagReader
from koop_bag.writer import BagWriter
from koop_lab.hil import faults, scenario
from koop_node.config import ConfigError
from koop_node.fields import check_type, parse_source, read_field
from koopman_lifter.config import shipped_model
from koopman_lifter.model import ModelError, load

SLOW = 5.0  # [s] for one input; a hang


@dataclass
class Outcome:
    """What fuzzing one target found.

    Attributes
    ----------
    inputs, accepted : int
        Inputs tried, and those that were no error.
    findings : list of str
        Inputs that raised something unexpected or took too long.
    slowest : float
        Longest time for one input [s].
    growth : float
        Growth of the resident memory over the second half [MB].
    """

    inputs: int = 0
    accepted: int = 0
    findings: list[str] = field(default_factory=list)
    slowest: float = 0.0
    growth: float = 0.0


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Return the data with some bytes changed, cut, doubled or replaced by telling values."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        place = rng.randrange(len(changed)) if changed else 0
        kind = rng.randrange(6)
        if kind == 0 and changed:
            changed[place] = rng.randrange(256)
        elif kind == 1 and changed:
            changed[place] ^= 1 << rng.randrange(8)
        elif kind == 2:
            del changed[place : place + rng.randint(1, 64)]
        elif kind == 3:
            changed[place:place] = rng.randbytes(rng.randint(1, 16))
        elif kind == 4:
            changed[place : place + 8] = rng.choice((b"\xff" * 8, bytes(8), b"\x7f" + b"\xff" * 7))
        else:
            changed[place:place] = changed[place : place + rng.randint(1, 64)]
    return bytes(changed[: rng.randrange(len(changed) + 1)] if rng.random() < 0.1 else changed)


def text(rng: random.Random, seeds: tuple[str, ...]) -> str:
    """Return a text near one of the seeds, or arbitrary."""
    if rng.random() < 0.2:
        return rng.randbytes(rng.randrange(40)).decode("latin-1")
    letters = "ab0_9[].,:/ =\n\x00é-~'\"\\%$;()"
    word = list(rng.choice(seeds))
    for _ in range(rng.randint(0, 4)):
        place = rng.randrange(len(word) + 1)
        word[place : place + rng.randrange(3)] = [rng.choice(letters)] * rng.choice((1, 1, 1, 200))
    return "".join(word)


Trial = Callable[[random.Random], None]


def fuzz(trial: Trial, expected: tuple[type[Exception], ...], inputs: int, seed: int) -> Outcome:
    """Try many inputs on one target; every input has a seed of its own, which names it."""
    outcome = Outcome()
    half = 0.0
    for number in range(inputs):
        if number == inputs // 2:
            half = _memory()
        begin = time.perf_counter()
        try:
            trial(random.Random(seed * 1_000_003 + number))
            outcome.accepted += 1
        except expected:
            pass
        except Exception as error:  # the very thing that is looked for
            outcome.findings.append(f"input {number} of seed {seed}: {error!r:.200}")
        took = time.perf_counter() - begin
        outcome.slowest = max(outcome.slowest, took)
        if took > SLOW:
            outcome.findings.append(f"input {number} of seed {seed}: took {took:.1f} s")
        outcome.inputs += 1
    outcome.growth = _memory() - half
    return outcome


def targets(folder: Path) -> dict[str, tuple[Trial, tuple[type[Exception], ...]]]:
    """Return what is fuzzed: a trial and the errors that it may raise."""
    model = shipped_model().read_bytes()
    bag = small_bag(folder / "seed")
    model_file, bag_file = folder / "fuzzed.npz", folder / "fuzzed.mcap"
    sample = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=2)),
        position=[1.0],
        name=["a"],
        data=b"12",
    )

    def load_model(rng: random.Random) -> None:
        model_file.write_bytes(mutate(model, rng))
        load(model_file)

    def read_bag(rng: random.Random) -> None:
        bag_file.write_bytes(mutate(bag, rng))
        with BagReader(bag_file) as reader:
            for topic in reader.topics:
                read_columns(reader, topic.name)

    def parse_fields(rng: random.Random) -> None:
        source = parse_source(text(rng, ("/joint_states:position[0],velocity[0]", "a:b.c[12].d")))
        for path in source.fields:
            if not isinstance(read_field(path, sample), float):
                raise AssertionError("no number")

    def parse_words(rng: random.Random) -> None:
        kind = rng.randrange(3)
        if kind == 0:
            check_type(text(rng, ("sensor_msgs/msg/JointState",)))
        elif kind == 1:
            faults.parse(text(rng, ("delayed delay=0.1 jitter=0.02", "garbage kind=nan", "off")))
        else:
            RecorderConfig(topics=text(rng, ("state /imu:sensor_msgs/msg/Imu",)))

    content = (
        "description: a\ntime_scale: 4\nevents:\n  - {at: 20, for: 5, inject: {state: slow}}\n"
        "limits: {wrong_by: 2.5}\nparameters: {relay_esc: {dwell: 3.0}}\n"
    )
    yaml_file = folder / "fuzzed.yaml"

    def read_scenario(rng: random.Random) -> None:
        yaml_file.write_bytes(mutate(content.encode(), rng))
        scenario.read(yaml_file)

    return {
        "model": (load_model, (ModelError,)),
        "bag": (read_bag, (BagError,)),
        "fields": (parse_fields, (ConfigError,)),
        "words": (parse_words, (ConfigError,)),
        "scenario": (read_scenario, (ConfigError,)),
    }


def small_bag(folder: Path) -> bytes:
    """Return the bytes of a small recording."""
    from koop_bag.schema import load_schema

    writer = BagWriter(folder)
    channel = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
    for step in range(20):
        message = bytes(4) + bytes(12) + step.to_bytes(8, "little") + bytes(24)
        writer.write(channel, step * 5_000_000, step * 5_000_000, message)
    writer.close()
    (file,) = folder.glob("*.mcap")
    return file.read_bytes()


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("fuzz", help="arbitrary bytes into everything that reads files")
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="model, bag, fields, ...")
    parser.add_argument("--inputs", type=int, default=100_000, help="for each target")
    parser.add_argument("--seed", type=int, default=0)
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if anything was found."""
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        known = targets(Path(folder))
        for name in args.targets or known:
            if name not in known:
                raise ConfigError(f"nothing called '{name}': choose {', '.join(known)}")
            begin = time.monotonic()
            outcome = fuzz(*known[name], args.inputs, args.seed)
            found += len(outcome.findings)
            print(
                f"{name:<10}{outcome.inputs} inputs, {outcome.accepted} accepted, "
                f"{len(outcome.findings)} findings, slowest {outcome.slowest * 1e3:.1f} ms, "
                f"memory {outcome.growth:+.1f} MB, {time.monotonic() - begin:.0f} s",
                flush=True,
            )
            for finding in outcome.findings[:10]:
                print(f"    {finding}")
    return 1 if found else 0


def _memory() -> float:
    """Return the peak resident memory [MB]: it grows if anything leaks."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return peak if math.isfinite(peak) else 0.0
