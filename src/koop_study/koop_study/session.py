"""One run of ``koop study``: read, compute, write."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path

from koop_core.config.parameter import ConfigError
from koop_study.experiments.kinds import KINDS, Experiment, read_folder
from koop_study.experiments.laws import LawsConfig
from koop_study.over_dds import repeat as over_dds
from koop_study.report import publish, summary
from koop_study.runner import run_all
from koop_study.workers.cluster import WorkerLost
from koop_study.workers.units import Store
from koop_view.report.markdown import rewrite_block

INTERRUPTED = 130


def run(args: argparse.Namespace) -> int:
    """Do what the options of ``koop study`` ask for; return the exit code.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If an experiment file or an option cannot be used.
    """
    begin = time.monotonic()
    if args.processes < 1:
        raise ConfigError(f"--processes {args.processes}: must be at least 1")
    for kind in args.kinds:
        if kind not in KINDS:
            raise ConfigError(f"unknown kind of experiment '{kind}': known are {', '.join(KINDS)}")
    readme = args.readme.read_text() if args.readme else ""
    if args.readme:
        for markers in ((publish.BEGIN, publish.END), publish.LAWS):
            rewrite_block(readme, "", markers)  # complain before the work, not after it
    experiments = [
        with_rivals(experiment, args.rivals)
        for experiment in read_folder(args.experiments, args.quick)
        if not args.kinds or experiment.kind in args.kinds
    ]
    if not experiments:
        raise ConfigError(f"{args.experiments}: has no experiment of the kinds asked for")
    out = args.out or Path("recordings/study-quick" if args.quick else "recordings/study")
    if args.over_dds:
        return 0 if over_dds.repeat(experiments, out) else 1
    store = Store(out / "units")
    try:
        sections = run_all(experiments, store, args.processes, args.scheduler)
    except KeyboardInterrupt:
        print(f"stopped; the same command goes on from what is in {out}", file=sys.stderr)
        return INTERRUPTED
    except WorkerLost as error:
        print(f"koop study: error: {error}", file=sys.stderr)
        return 1
    command = remake(args)
    for folder in (out, *([args.publish] if args.publish else [])):
        path = publish.write(folder, sections, experiments, command)
    if args.readme:
        report = os.path.relpath(path, args.readme.parent)
        args.readme.write_text(publish.rewrite(readme, sections, report))
    for claim in summary.sentences(summary.by_name(sections)):
        print(f"- {claim.text}")
    print(f"{path} ({time.monotonic() - begin:.0f} s)")
    return 0


def with_rivals(experiment: Experiment, python: Path | None) -> Experiment:
    """Return the experiment with the Python of other packages' laws, which it checks."""
    if not isinstance(experiment.config, LawsConfig):
        return experiment
    if python is not None:
        experiment = replace(experiment, config=replace(experiment.config, rivals=str(python)))
    experiment.config.needs()
    if experiment.config.left_out:
        print(f"without --rivals: no {', '.join(experiment.config.left_out)}", file=sys.stderr)
    return experiment


def remake(args: argparse.Namespace) -> str:
    """Return the command line that makes the same report again."""
    words = ["koop", "study", *args.kinds]
    if args.quick:
        words.append("--quick")
    if args.experiments != Path("experiments"):
        words += ["--experiments", str(args.experiments)]
    if args.rivals:
        words += ["--rivals", "PYTHON"]  # where it is means nothing to another reader
    return shlex.join(words)
