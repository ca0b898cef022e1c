"""The kinds of experiments, and reading a folder of experiment files."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from koop_core.config.parameter import ConfigError, nearest
from koop_study.experiments import (
    ablations,
    closed_loop,
    commission,
    laws,
    modes,
    robustness,
    sensitivity,
    static_maps,
)
from koop_study.experiments.spec import parse, quickened, read_file
from koop_study.simulation import work
from koop_study.workers.units import Unit
from koop_view.report.document import Section

Steps = Generator[list[Unit], list[Any], Section]


def _once(module: Any) -> Callable[[Any], Steps]:
    """Return the steps of an experiment whose units are all known beforehand."""

    def steps(config: Any) -> Steps:
        results = yield module.units(config)
        section = module.section(config, results)
        assert isinstance(section, Section)
        return section

    return steps


KINDS: dict[str, tuple[type[Any], Callable[[Any], Steps]]] = {  # in the order of the report
    "modes": (modes.ModesConfig, _once(modes)),
    "static_maps": (static_maps.StaticMapsConfig, _once(static_maps)),
    "closed_loop": (closed_loop.ClosedLoopConfig, _once(closed_loop)),
    "robustness": (robustness.RobustnessConfig, _once(robustness)),
    "sensitivity": (sensitivity.SensitivityConfig, _once(sensitivity)),
    "ablations": (ablations.AblationsConfig, _once(ablations)),
    "laws": (laws.LawsConfig, laws.steps),
    "commission": (commission.CommissionConfig, _once(commission)),
}


@dataclass(frozen=True)
class Experiment:
    """One experiment file, read and checked.

    Attributes
    ----------
    path : Path
        The file.
    kind : str
        A key of :data:`KINDS`.
    content : dict
        Settings in force, in YAML terms.
    config : object
        The same as the kind's configuration class.
    """

    path: Path
    kind: str
    content: dict[str, Any]
    config: Any

    def steps(self) -> Steps:
        """Return the generator that asks for units and ends with a section of the report."""
        return KINDS[self.kind][1](self.config)


def read(path: Path, quick: bool) -> Experiment:
    """Read one experiment file.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If anything in it is unknown, missing, out of range or without effect; the message names
        file and key.
    """
    content = quickened(read_file(path), quick)
    kind = content.pop("experiment", None)
    if kind not in KINDS:
        raise ConfigError(f"{path}: unknown experiment {kind!r}: {nearest(str(kind), KINDS)}")
    experiment = Experiment(path, kind, content, parse(KINDS[kind][0], content, str(path)))
    for unit in next(experiment.steps()):
        if unit.work not in work.WORK:
            continue  # checked where its configuration is read
        try:
            work.check(unit.work, unit.arguments)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
    return experiment


def read_folder(folder: Path, quick: bool) -> list[Experiment]:
    """Read every ``*.yaml`` of a folder, in the order of the report.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there is none, or one is wrong.
    """
    found = [read(path, quick) for path in sorted(folder.glob("*.yaml"))]
    if not found:
        raise ConfigError(f"{folder}: has no experiment files (*.yaml)")
    return in_order(found)


def in_order(experiments: list[Experiment]) -> list[Experiment]:
    """Return experiments in the order of the report."""
    order = list(KINDS)
    return sorted(experiments, key=lambda experiment: order.index(experiment.kind))
