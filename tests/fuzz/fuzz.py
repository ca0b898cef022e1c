"""The fuzzer: damaged files and texts into everything that reads such from outside.

An input either works or is refused with the reader's own error, in one line that can be printed;
anything else is a finding. So are an input that takes long and one that takes much memory.
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any

import numpy as np
import yaml
from mutate import BagMaker, ModelMaker, cdr, mutate, text, tree

from koop_bag.bag.columns import read_columns
from koop_bag.bag.info import as_text, describe
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError
from koop_bag.recorder.config import RecorderConfig
from koop_core.config.fields import check_fields, check_type, parse_source
from koop_core.config.parameter import ConfigError
from koop_core.stream.arrival import Arrival
from koop_hil import faults, scenario
from koop_node.node.adapter import StateAdapter
from koopman_lifter import cost
from koopman_lifter.config import shipped_model
from koopman_lifter.delays import Delays
from koopman_lifter.edmd import Gram
from koopman_lifter.model import ModelError, build, load
from koopman_lifter.observables import Monomials

SLOW = 5.0  # [s] for one input; a hang
LARGE = 200.0  # [MB] that one input may add to the peak of memory
LONG = 1000  # characters of one line
_DETAILS = re.compile(r"'[^']*'|\"[^\"]*\"|\S*/\S*|\[.*\]|\(.*\)|-?\d[\w.+]*")


class Hang(BaseException):
    """An input took too long; no reader's own ``except Exception`` may take it."""


@dataclass
class Outcome:
    """What fuzzing one target found.

    Attributes
    ----------
    inputs, accepted : int
        Inputs tried, and those that were not an error.
    findings : list of str
        Inputs that raised something unexpected, or took too long or too much.
    slowest : float
        Longest time for one input [s].
    largest : float
        What one input added at most to the peak of memory [MB].
    growth : float
        Growth of the resident memory over the second half [MB].
    answers : Counter of str
        How often each check refused an input: its text without names and numbers.
    """

    inputs: int = 0
    accepted: int = 0
    findings: list[str] = field(default_factory=list)
    slowest: float = 0.0
    largest: float = 0.0
    growth: float = 0.0
    answers: Counter[str] = field(default_factory=Counter)


Trial = Callable[[Random], None]


def fuzz(
    trial: Trial,
    expected: tuple[type[Exception], ...],
    inputs: int,
    seed: int,
    first: int = 0,
    slow: float = SLOW,
) -> Outcome:
    """Try many inputs on one target; every input has a seed of its own, which names it."""
    outcome = Outcome()
    half = 0.0
    for number in range(first, first + inputs):
        if number == first + inputs // 2:
            half = _resident()
        begin, before = time.perf_counter(), _peak()
        problem = ""
        try:
            with _time_limit(slow):
                trial(Random(seed * 1_000_003 + number))
            outcome.accepted += 1
        except expected as error:
            words = str(error)
            outcome.answers[_DETAILS.sub("_", words)[:70]] += 1
            if not words.isprintable() or len(words) > LONG:
                problem = f"refused, but not in one line: {len(words)} characters, {words!r:.100}"
        except Hang:
            problem = "hangs"
        except Exception as error:  # the very thing that is looked for
            problem = f"{error!r:.200}"
        took, grown = time.perf_counter() - begin, _peak() - before
        if grown > LARGE and number > first:
            problem = problem or f"took {grown:.0f} MB"
        if problem:
            outcome.findings.append(f"input {number} of seed {seed}: {problem}")
        outcome.slowest = max(outcome.slowest, took)
        outcome.largest = max(outcome.largest, grown)
        outcome.inputs += 1
    outcome.growth = _resident() - half
    return outcome


def delayed_model(folder: Path) -> bytes:
    """Return a model file of version 2, with all that it may hold."""
    delays = Delays(1, 3, 2)
    gram = Gram.empty(Monomials(delays.n, 2))
    samples = np.random.default_rng(0).normal(size=(1, 1000))
    gram.add_trajectory(delays.embed(samples))
    build(gram, 0.01, ("x",), 4, {}, delays).save(folder / "delayed.npz")
    return (folder / "delayed.npz").read_bytes()


def targets(folder: Path) -> dict[str, tuple[Trial, tuple[type[Exception], ...]]]:
    """Return what is fuzzed: a trial and the errors that it may raise."""
    models = [ModelMaker(shipped_model().read_bytes()), ModelMaker(delayed_model(folder))]
    bag = BagMaker(small_bag(folder / "seed"), _topics())
    model_file, bag_file = folder / "fuzzed.npz", folder / "fuzzed.mcap"
    messages = _messages()

    def load_model(rng: Random) -> None:
        model_file.write_bytes(rng.choice(models)(rng))
        loaded = load(model_file)
        names = loaded.delays.names(loaded.state_names, loaded.dt)
        if len(loaded.observables.names(names)) != loaded.observables.p:
            raise AssertionError("wrong names")
        lifting = loaded.lifting()
        x, work = np.full(lifting.channels, 0.5), cost.workspace(lifting)
        for source in (cost.RAW, cost.LIFTED):
            params = cost.detector_params(20.0, 0.3, loaded.dt)
            cost.answer(source, lifting, params, cost.initial(), int(Arrival.RESTART), 0, x, work)

    def read_bag(rng: Random) -> None:
        bag_file.write_bytes(bag(rng))
        rescued = folder / "rescued"
        problem: BagError | None = None
        try:
            with BagReader(bag_file) as reader:
                as_text(describe(reader), with_parameters=True)
                for _ in reader.messages():
                    pass
                for topic in reader.topics:
                    read_columns(reader, topic.name)
        except BagError as error:
            problem = error
        if rng.random() < 0.1:  # also of bags that were refused
            shutil.rmtree(rescued, ignore_errors=True)
            recover(bag_file, rescued)
            with BagReader(rescued) as reader:
                describe(reader)
        if problem is not None:
            raise problem

    def parse_fields(rng: Random) -> None:
        message = rng.choice(messages)
        source = parse_source(text(rng, _SOURCES) if rng.random() < 0.3 else _source(message, rng))
        check_fields(source.fields, type(message)())
        adapter = StateAdapter(source, 0.005)
        for _ in range(3):
            if hasattr(message, "header"):
                message.header.stamp.sec = rng.choice((0, 1, 2, 2**31 - 1, -(2**31)))
                message.header.stamp.nanosec = rng.choice((0, 5_000_000, 2**32 - 1))
            step, x = adapter.convert(message)
            if not 0 <= step < 2**64 or any(type(value) is not float for value in x):
                raise AssertionError("no step or no number")

    def parse_words(rng: Random) -> None:
        kind = rng.randrange(3)
        if kind == 0:
            check_type(text(rng, ("sensor_msgs/msg/JointState",)))
        elif kind == 1:
            faults.parse(text(rng, ("delayed delay=0.1 jitter=0.02", "garbage kind=nan", "off")))
        else:
            RecorderConfig(topics=text(rng, ("state /imu:sensor_msgs/msg/Imu",)))

    content = (
        "description: a\ntime_scale: 4\nevents:\n  - {at: 20, for: 5, inject: {state: slow}}\n"
        "limits: {max_error: 2.5}\nparameters: {relay_esc: {dwell: 3.0}}\n"
    )
    yaml_file = folder / "fuzzed.yaml"

    def read_scenario(rng: Random) -> None:
        if rng.random() < 0.3:
            yaml_file.write_bytes(mutate(content.encode(), rng))
        else:
            words = yaml.safe_dump(tree(yaml.safe_load(content), rng), allow_unicode=True)
            yaml_file.write_text(words, errors="replace")
        scenario.read(yaml_file)

    return {
        "model": (load_model, (ModelError,)),
        "bag": (read_bag, (BagError,)),
        "fields": (parse_fields, (ConfigError,)),
        "words": (parse_words, (ConfigError,)),
        "scenario": (read_scenario, (ConfigError,)),
    }


_SOURCES = (
    "/joint_states:position[0],velocity[0]",
    "a:status[0].values[1].value,status[0].level",
    "adc:data[0],layout.dim[0].size",
    "m:orientation_covariance[8],header.stamp.sec",
    "t:vertex_indices[2]",
)


def _messages() -> list[Any]:
    """Return messages as rigs send them: with short and long arrays, texts and messages inside."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from sensor_msgs.msg import Imu, JointState
    from shape_msgs.msg import MeshTriangle
    from std_msgs.msg import Float64MultiArray

    status = DiagnosticStatus(name="a", values=[KeyValue(key="b", value="1")])
    return [
        JointState(name=["a"], position=[1.0, 2.0], velocity=[3.0]),
        Float64MultiArray(data=[1.0]),
        DiagnosticArray(status=[status]),
        Imu(),
        MeshTriangle(),
    ]


def _source(message: Any, rng: Random) -> str:
    """Return a source whose fields the message has, or nearly."""
    fields = []
    for _ in range(rng.choice((1, 1, 1, 2, 2, 65))):
        value: Any = message
        words = ""
        for _ in range(rng.randint(2, 5)):
            field_types: dict[str, str] = getattr(value, "get_fields_and_field_types", dict)()
            names = list(field_types) or ["x"]
            name = rng.choice(names) if rng.random() < 0.95 else rng.choice(("SLOT_TYPES", "_data"))
            value, words = getattr(value, name, None), f"{words}.{name}"
            if hasattr(value, "__len__") and rng.random() < 0.95:
                words += f"[{rng.choice((0, 0, 0, 1, 1, 2, 8, 999999))}]"
                value = next(iter(value), None)
            if rng.random() < 0.03:
                words += rng.choice((" ", "\t", "[]", "[0]", "[-1]", ".", "é", "()", "[0][0]"))
            if not hasattr(value, "get_fields_and_field_types"):
                break
        fields.append(words[1:])
    topic = rng.choice(("/a", "a/b", "~/a", "a", "/a_1/b")) if rng.random() < 0.95 else "a b"
    return f"{topic}:{','.join(fields)}"


def _topics() -> dict[str, tuple[str, str, bytes]]:
    """Return the topics of a bag, each with a type of another kind and a message."""
    header = (("i", 1), ("I", 2), ("s", "a"))
    messages = {
        "koop_msgs/msg/MeasuredState": cdr(
            *header, ("Q", 1), ("?", 1), ("I", 2), ("d", 0.5), ("d", 2.0)
        ),
        "sensor_msgs/msg/JointState": cdr(
            *header, ("I", 1), ("s", "joint"), ("I", 1), ("d", 1.0), ("I", 0), ("I", 0)
        ),
        "koop_msgs/msg/Cost": cdr(
            *header, ("Q", 1), ("?", 1), ("d", 0.01), ("d", 1.0), ("d", 1.0), ("B", 1), ("?", 0),
            ("s", "id"),
        ),
        "diagnostic_msgs/msg/DiagnosticArray": cdr(
            *header, ("I", 1), ("B", 0), *(("s", word) for word in "abc"),
            ("I", 1), ("s", "key"), ("s", "value"),
        ),
    }  # fmt: skip
    return {
        f"/{name.rpartition('/')[2]}": (name, load_schema(name).text, message)
        for name, message in messages.items()
    }


def small_bag(folder: Path) -> bytes:
    """Return the bytes of a small recording."""
    with BagWriter(folder) as writer:
        for topic, (name, _, message) in _topics().items():
            channel = writer.add_topic(topic, load_schema(name))
            for step in range(5):
                writer.write(channel, step * 5_000_000, step * 5_000_000, message)
    (file,) = folder.glob("*.mcap")
    return file.read_bytes()


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(description=__doc__)
    result.add_argument("targets", nargs="*", metavar="TARGET", help="model, bag, fields, ...")
    result.add_argument("--inputs", type=int, default=100_000, help="for each target")
    result.add_argument("--seed", type=int, default=0)
    result.add_argument("--first", type=int, default=0, help="number of the first input")
    result.add_argument("--answers", action="store_true", help="print what refused how many")
    return result


def main() -> int:
    """Entry point; returns the exit code: 1 if anything was found."""
    args = parser().parse_args()
    actual = 0
    with tempfile.TemporaryDirectory() as folder:
        reference = targets(Path(folder))
        for name in args.targets or reference:
            if name not in reference:
                raise ConfigError(f"nothing called '{name}': choose {', '.join(reference)}")
            begin = time.monotonic()
            outcome = fuzz(*reference[name], args.inputs, args.seed, args.first)
            actual += len(outcome.findings)
            print(
                f"{name:<10}{outcome.inputs} inputs, {outcome.accepted} accepted, "
                f"{len(outcome.findings)} findings, slowest {outcome.slowest * 1e3:.1f} ms, "
                f"largest {outcome.largest:.1f} MB, memory {outcome.growth:+.1f} MB, "
                f"{time.monotonic() - begin:.0f} s",
                flush=True,
            )
            for finding in outcome.findings[:10]:
                print(f"    {finding}")
            for answer, count in outcome.answers.most_common(30) if args.answers else ():
                print(f"{count / outcome.inputs:8.2%} {answer}")
    return 1 if actual else 0


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise Hang after a time."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _peak() -> float:
    """Return the peak of the resident memory [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _resident() -> float:
    """Return the resident memory [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


if __name__ == "__main__":
    sys.exit(main())
