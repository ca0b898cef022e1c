"""``koop verify``: closes the loop with the tuned controller; compares it with the prediction."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from koop_commission.stages.closed_loop import ClosedLoop
from koop_commission.stages.session import refuse_small_disk, resumable, spell_time
from koop_core.config.knobs import format_knobs
from koop_core.text_table import table
from koop_core.whole_file import write_json
from koop_guard.note import note_of
from koop_tune.excitation import progress
from koop_tune.excitation.bowl import find_starts
from koop_tune.excitation.progress import ExcitationProgress
from koop_tune.folder import TUNED
from koop_tune.result import tune_result
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.agreement import (
    Aim,
    find_disagreements,
    find_faults,
    name_gains,
    spell,
    spell_goal,
    verdict,
)
from koop_tune.search.prediction import Band
from koop_tune.search.rounds import (
    VERIFIED,
    Round,
    Verification,
    inform,
    load_verification,
)


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "verify",
        description="Closes the loop with the controller of 'koop tune', from both ends of "
        "theta's range (of several knobs: from two opposite corners), records it, and compares "
        "it with the prediction. The guard keeps theta "
        "within its limits and rate and returns it to theta_safe, as in 'koop excite'. The same "
        "command resumes an interrupted one. Exit code 0 only if the rig is damped.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="rig file, from 'koop commission --new'")
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="folder of 'koop excite' and 'koop tune'"
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig is damped."""
    from koop_commission.report import try_report  # slow to import

    rig = rig_file.read(args.rig)
    with resumable(rig, f"./koop verify {args.rig} {args.folder}"):
        verification = verify(rig, args.folder, note_of(args.rig))
    print(format_verdict(verification, verification.rounds[-1], rig.sense))
    print(try_report(args.folder))
    return 0 if verification.damped else 1


def verify(rig: RigFile, folder: Path, note: Path | None = None) -> Verification:
    """Close the loop from each start, and return the content of verify.json.

    The folder is that of the excitation and holds ``tuned``; a round that was begun there is
    resumed. ``note`` is the file that notes where theta was left.

    Raises
    ------
    koop_core.errors.LiveError
        If it ends early; theta is at theta_safe then.
    koop_core.config.parameter.ConfigError
        If the folder holds no controller for this rig.
    """
    rig, state = _read_excitation(rig, folder)
    aim = tune_result.read(folder / TUNED).make_aim(rig)
    rounds = list(load_verification(folder).rounds)
    if not rounds or rounds[-1].finished or rounds[-1].prediction != aim.predicted:
        rounds.append(Round(len(rounds) + 1, aim.predicted, best=aim.y))
    current = rounds.pop()
    aim = inform(aim, rounds)
    done = [run.start for run in current.runs]
    left = [theta for theta in find_starts(rig, *state.arrays(rig)) if theta not in done]
    settling = max([aim.time, aim.growth, *(hold.settled for hold in state.holds)])
    loop = ClosedLoop(rig, aim, folder, current.number, settling, note)
    rest = 2 * aim.settings.before * aim.window
    besides = settling + aim.time + rest + 1.5 * rig.guard.longest_return * rig.pace
    refuse_small_disk(rig, folder, len(left) * (besides + aim.longest))
    least, most = (
        spell_time(len(left) * (besides + closed), rig.pace)
        for closed in (aim.duration, aim.longest)
    )
    print(
        f"closing the loop from theta = {' and '.join(map(spell, left))}: "
        f"{aim.duration:.0f} s each where that confirms the prediction, else up to "
        f"{aim.longest:.0f} s; in all from {least} to {most}; Ctrl-C ends it, theta returns to "
        f"{rig.spell('theta_safe')}",
        flush=True,
    )
    for start in left:
        current = replace(current, runs=(*current.runs, loop.record(start)))
        write_json(folder / VERIFIED, Verification((*rounds, current)))
    worse = [text for run in current.runs for text in find_disagreements(aim, run.measured)]
    faults = find_faults(aim, [run.measured for run in current.runs])
    summary = "; ".join(faults or worse) or f"{spell_goal(aim.sense)} as predicted"
    current = replace(current, agrees=not worse, damped=not faults, summary=summary)
    return _conclude((*rounds, current), len(rounds), aim, folder)


def _read_excitation(rig: RigFile, folder: Path) -> tuple[RigFile, ExcitationProgress]:
    """Return the rig with the limits that kept its constraint, and its excitation."""
    state = progress.load(rig, folder) or ExcitationProgress()
    return state.narrow(rig), state


def judge(rig: RigFile, folder: Path, index: int) -> Verification:
    """Write the verdict on the controller of ``tuned`` into verify.json, and return its content.

    ``index`` is the round in which that controller was verified; the first is 0.
    """
    aim = tune_result.read(folder / TUNED).make_aim(_read_excitation(rig, folder)[0])
    rounds = load_verification(folder).rounds
    return _conclude(rounds, index, inform(aim, rounds[:index]), folder)


def _conclude(rounds: tuple[Round, ...], index: int, aim: Aim, folder: Path) -> Verification:
    runs = [run.measured for run in rounds[index].runs]
    text = verdict(aim, runs, len(rounds), str(folder))
    verification = Verification(rounds, not find_faults(aim, runs), aim.name, text)
    write_json(folder / VERIFIED, verification)
    return verification


def format_verdict(verification: Verification, item: Round, sense: float) -> str:
    """Return the verdict on the controller of a round, before the round's table."""
    return f"\n{verification.verdict}\n\n{format_round(item, sense)}\n"


def format_round(item: Round, sense: float) -> str:
    """Return the runs of a round beside the prediction, as a table.

    ``sense`` is +1 if little amplitude is wanted, else -1.
    """
    excess, reduction = name_gains(sense)
    p, runs = item.prediction, [run.measured for run in item.runs]

    def row(name: str, values: list[float | None], band: Band, unit: float = 1.0) -> list[str]:
        cells = ["never" if value is None else f"{unit * value:.3g}" for value in values]
        return [name, *cells, band.as_text(unit)]

    rows = [
        row("converges within [s]", [run.time_to_converge for run in runs], p.converges),
        row("|theta - theta*| [% of range]", [run.distance for run in runs], p.distance, 100.0),
        row(excess, [run.excess for run in runs], p.excess),
        row(reduction, [run.reduction for run in runs], p.reduction),
        ["mean of theta", *(spell(run.theta) for run in runs), ""],
        ["swing of theta", *(format_knobs(run.swing, ".3g") for run in runs), ""],
    ]
    starts = [f"from {spell(run.start)}" for run in item.runs]
    return table([f"round {item.number}", *starts, "predicted"], rows)
