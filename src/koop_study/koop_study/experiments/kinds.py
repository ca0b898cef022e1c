"""The kinds of experiments, and reading a folder of experiment files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from koop_core.config.objects import parse
from koop_core.config.parameter import ConfigError, mapping, nearest
from koop_core.config.yaml_file import read_yaml
from koop_study.experiments import cases, commission, knobs, modes, static_maps
from koop_study.simulation import work
from koop_study.workers.units import Unit
from koop_view.report.document import Section

KINDS: dict[str, tuple[type[Any], Any]] = {  # configuration and module
    "modes": (modes.ModesConfig, modes),
    "static_maps": (static_maps.StaticMapsConfig, static_maps),
    "cases": (cases.CasesConfig, cases),
    "commission": (commission.CommissionConfig, commission),
    "knobs": (knobs.KnobsConfig, knobs),
}
ORDER = ("modes", "static_maps", "closed_loop", "robustness", "sensitivity", "ablations")


@dataclass(frozen=True)
class Experiment:
    """One experiment file, read and checked."""

    path: Path
    """The file."""
    kind: str
    """A key of :data:`KINDS`."""
    content: dict[str, Any]
    """Settings in force, in YAML terms."""
    config: Any
    """The same as the kind's configuration class."""

    def units(self) -> list[Unit]:
        """Return the units of work that the experiment needs."""
        return list(KINDS[self.kind][1].units(self.config))

    def section(self, results: list[Any]) -> Section:
        """Return the experiment's part of the report, from the results of its units."""
        section: Section = KINDS[self.kind][1].section(self.config, results)
        return section


def read(path: Path, quick: bool) -> Experiment:
    """Read one experiment file.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If anything in it is unknown, missing, out of range or without effect; the message names
        file and key.
    """
    content = mapping(read_yaml(path), f"{path}: the file")
    changes = mapping(content.pop("quick", {}), "quick")
    content = {**content, **changes} if quick else content
    kind = content.pop("experiment", None)
    if not isinstance(kind, str) or kind not in KINDS:
        raise ConfigError(f"{path}: unknown experiment {kind!r}: {nearest(str(kind), KINDS)}")
    experiment = Experiment(path, kind, content, parse(KINDS[kind][0], content, str(path)))
    for unit in experiment.units():
        try:
            work.check(unit.work, unit.arguments)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
    return experiment


def read_folder(folder: Path, quick: bool) -> list[Experiment]:
    """Read every ``*.yaml`` of a folder, in the order of the report.

    Raises ConfigError if there is none, or one is wrong.
    """
    experiments = [read(path, quick) for path in sorted(folder.glob("*.yaml"))]
    if not experiments:
        raise ConfigError(f"{folder}: has no experiment files (*.yaml)")
    return in_order(experiments)


def in_order(experiments: list[Experiment]) -> list[Experiment]:
    """Return experiments in the order of the report."""
    order = {name: place for place, name in enumerate(ORDER)}
    return sorted(experiments, key=lambda item: order.get(item.path.stem, len(order)))
