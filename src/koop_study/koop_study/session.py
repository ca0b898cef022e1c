"""One run of ``koop study``: read, compute, write."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from koop_core.config.parameter import ConfigError
from koop_study.experiments.kinds import Experiment, in_order, read, read_folder
from koop_study.report import page, summary
from koop_study.workers.cluster import compute_all
from koop_study.workers.units import Store
from koop_view.report.document import Section

EXPERIMENTS = Path("experiments")  # of the repository, in whose root the study runs
INTERRUPTED = 130


def run(args: argparse.Namespace) -> int:
    """Run ``koop study`` with its options; return the exit code.

    Raises ConfigError if an experiment file or an option cannot be used.
    """
    begin = time.monotonic()
    if args.processes < 1:
        raise ConfigError(f"--processes {args.processes}: must be at least 1")
    experiments = choose(args.names, args.quick)
    out = args.out or Path("recordings/study-quick" if args.quick else "recordings/study")
    store = Store(out / "units")
    try:
        sections = run_all(experiments, store, args.processes, args.scheduler)
    except KeyboardInterrupt:
        print(f"stopped; the same command resumes from what is in {out}", file=sys.stderr)
        return INTERRUPTED
    command = shlex.join(["koop", "study", *args.names, *(["--quick"] if args.quick else [])])
    path = page.write(out, sections, experiments, command)
    for claim in summary.sentences(summary.by_name(sections)):
        print(f"- {claim.text}")
    print(f"{path} ({time.monotonic() - begin:.0f} s)")
    return 0


def run_all(
    experiments: Sequence[Experiment], store: Store, processes: int, scheduler: str = ""
) -> list[Section]:
    """Return one section an experiment; all units share the workers."""
    units = [experiment.units() for experiment in experiments]
    every = [unit for some in units for unit in some]
    results = iter(compute_all(every, store, processes, scheduler))
    return [
        experiment.section([next(results) for _ in some])
        for experiment, some in zip(experiments, units, strict=True)
    ]


def choose(names: list[str], quick: bool) -> list[Experiment]:
    """Return the experiments of the files that are named; all of the repository without a name.

    Raises ConfigError if there is no such file, or it cannot be used.
    """
    if not names:
        return read_folder(EXPERIMENTS, quick)
    paths = [Path(n) if n.endswith(".yaml") else EXPERIMENTS / f"{n}.yaml" for n in names]
    for name, path in zip(names, paths, strict=True):
        if path.parent == EXPERIMENTS and not path.exists():
            shipped = ", ".join(sorted(item.stem for item in EXPERIMENTS.glob("*.yaml")))
            raise ConfigError(f"unknown experiment '{name}': known are {shipped}")
    return in_order([read(path, quick) for path in paths])
