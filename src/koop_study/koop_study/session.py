"""One run of ``koop study``: read, compute, write."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from pathlib import Path

from koop_core.config.parameter import ConfigError
from koop_study import over_dds
from koop_study.experiments.kinds import KINDS, Experiment, in_order, read, read_folder
from koop_study.report import page, summary
from koop_study.runner import run_all
from koop_study.workers.cluster import WorkerLost
from koop_study.workers.units import Store

EXPERIMENTS = Path("experiments")  # of the repository, in whose root the study runs
INTERRUPTED = 130


def run(args: argparse.Namespace) -> int:
    """Run ``koop study`` with its options; return the exit code.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If an experiment file or an option cannot be used.
    """
    begin = time.monotonic()
    if args.processes < 1:
        raise ConfigError(f"--processes {args.processes}: must be at least 1")
    experiments = chosen(args.kinds, args.quick)
    out = args.out or Path("recordings/study-quick" if args.quick else "recordings/study")
    if args.over_dds:
        return 0 if over_dds.repeat(experiments, out) else 1
    store = Store(out / "units")
    try:
        sections = run_all(experiments, store, args.processes, args.scheduler)
    except KeyboardInterrupt:
        print(f"stopped; the same command resumes from what is in {out}", file=sys.stderr)
        return INTERRUPTED
    except WorkerLost as error:
        print(f"koop study: error: {error}", file=sys.stderr)
        return 1
    command = shlex.join(["koop", "study", *args.kinds, *(["--quick"] if args.quick else [])])
    for folder in (out, *([args.publish] if args.publish else [])):
        path = page.write(folder, sections, experiments, command)
    for claim in summary.sentences(summary.by_name(sections)):
        print(f"- {claim.text}")
    print(f"{path} ({time.monotonic() - begin:.0f} s)")
    return 0


def chosen(names: list[str], quick: bool) -> list[Experiment]:
    """Return the experiments that kinds and files name; all of the repository without a name.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a name is neither, or a file cannot be used.
    """
    files = [name for name in names if name.endswith(".yaml")]
    kinds = [name for name in names if name not in files]
    for kind in kinds:
        if kind not in KINDS:
            raise ConfigError(
                f"unknown kind of experiment '{kind}': known are {', '.join(KINDS)}; "
                "a file's name ends with .yaml"
            )
    experiments = [read(Path(name), quick) for name in files]
    if kinds or not files:
        experiments += [
            experiment
            for experiment in read_folder(EXPERIMENTS, quick)
            if not kinds or experiment.kind in kinds
        ]
    return in_order(experiments)
