"""The rig of a scenario, commissioned as any rig is, and what came of it as a row of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from koop_bringup.live.process import START_TIMEOUT
from koop_commission.command import Commissioning
from koop_commission.stages.session import Watch
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_hil.excite import rig_of
from koop_hil.processes import Processes
from koop_hil.scenario import Scenario
from koop_hil.supervisor import refuse_dead
from koop_node.client.alone import alone
from koop_tune.excitation import progress
from koop_tune.folder import FIGURES
from koop_tune.rig import rig_file
from koop_tune.search.agreement import as_predicted, ended, kept_round
from koop_tune.search.rounds import load_verification
from koop_view.report.markdown import rewrite_block

BEGIN, END = "<!-- commissioned -->", "<!-- /commissioned -->"
HEAD = (
    "| rig | excited | cost, law | θ* of the recording (true) | rounds | converges in | "
    "amplitude over the best | reduction, a factor of | θ at the end | verdict |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def commission_rig(scenario: Scenario, folder: Path, time: float) -> int:
    """Run the scenario's plant and commission it; return the exit code.

    Parameters
    ----------
    scenario : Scenario
        Its plant, time scale and seed are used; its events and limits are not.
    folder : Path
        Of all that is recorded and found; what was begun there goes on.
    time : float
        That theta may be moved over its range [s].

    Raises
    ------
    koop_core.errors.LiveError
        If the rig, a node or the disk ends it.
    """
    rig = rig_of(scenario, time)
    scenario = replace(scenario, setting=replace(scenario.setting, pace="scaled"))
    with alone(topics=["state", "ground_truth"]):
        pass  # nobody speaks for the plant that is started now
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "rig.yaml"
    if not file.exists():
        rig_file.write(rig, file)
    with Processes(folder, scenario, controlled=False) as processes:
        watch = Watch(None, lambda: refuse_dead(processes), START_TIMEOUT)
        try:
            return Commissioning(rig, file, folder, watch).run()
        except LiveError as error:
            raise LiveError(f"{error}; the same command goes on") from None


def row(scenario: Scenario, folder: Path) -> str:
    """Return what a commissioned folder came to, as a row of a Markdown table."""
    tuned = progress.noted(folder / "tuned" / FIGURES)
    known = progress.noted(folder / progress.NAME)
    first = f"| {scenario.name} | {known.get('elapsed', 0.0):.0f} s "
    if "constants" not in tuned:
        why = f"{tuned.get('verdict', 'not tuned')}: {tuned.get('why', '')}"
        return f"{first}| | | | | | | | {why} |"
    found = load_verification(folder).as_json()
    first += (
        f"| {tuned['cost']}, {tuned['constants']['law']} | {tuned['theta_best']:.2f} "
        f"({scenario.setting.theta_star:g}) | {len(found['rounds'])} "
    )
    if not (rounds := ended(found["rounds"])):
        return f"{first}| | | | | not verified |"
    kept = rounds[kept_round(rounds)]  # whose controller is in the folder
    runs, predicted = kept["runs"], kept["prediction"]

    def told(name: str, band: str, form: str) -> str:
        values = ", ".join("never" if r[name] is None else f"{r[name]:{form}}" for r in runs)
        high = {k: "never" if v is None else f"{v:{form}}" for k, v in predicted[band].items()}
        return f"{values} ({high['low']} to {high['high']})"

    ends = ", ".join(f"{run['theta']:.2f}" for run in runs)
    verdict = (
        "damped as predicted" if as_predicted(kept)
        else f"{'' if found['damped'] else 'not '}damped; {kept['says']}"
    )  # fmt: skip
    return (
        f"{first}| {told('time_to_converge', 'converges', '.0f')} s "
        f"| {told('excess', 'excess', '.2f')} | {told('reduction', 'reduction', '.2f')} "
        f"| {ends} | {verdict} |"
    )


def publish(rows: Sequence[str], path: Path) -> None:
    """Put a table between the marks of a Markdown file.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it has none.
    """
    try:
        text = rewrite_block(
            path.read_text(encoding="utf-8"), "\n".join([HEAD, *rows]), (BEGIN, END)
        )
    except ValueError:
        raise ConfigError(f"{path}: has no lines {BEGIN} and {END}") from None
    path.write_text(text, encoding="utf-8")
