"""``koop commission``: from an unknown rig to a damped one; each stage resumes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from koop_bringup.live.served import add_serve_option, served
from koop_commission.stages import check, new_rig_file, verify
from koop_commission.stages.excite import describe_result, excite
from koop_commission.stages.session import resumable
from koop_core import whole_file
from koop_core.config.parameter import ConfigError
from koop_guard.note import note_of
from koop_tune.excitation import progress
from koop_tune.excitation.design import FLAT, KNOWN
from koop_tune.folder import CONTROLLER, RIG, TUNED
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.agreement import spell_goal
from koop_tune.search.rounds import Round, find_slowdown, kept_index, load_verification
from koop_tune.search.settings import VERIFICATION, TuningSettings

NAME = "commission.json"
RECORDINGS = Path("recordings")


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "commission",
        description="Checks a rig, moves theta over its range and records, tunes a controller, "
        "closes the loop and compares it with the prediction; where they disagree it tunes again "
        "with the new recordings, at most three rounds. Whatever ends it, theta returns to "
        "theta_safe, and the same command resumes. Exit code 0 only if the rig is "
        "damped. With --new it asks for the content of a rig file and proposes topics and "
        "fields of the live graph; Enter takes the proposal in brackets.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", nargs="?", help="rig file, from --new")
    parser.add_argument("--new", type=Path, metavar="FILE", help="ask, and write this rig file")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER",
        help="folder of recordings and results (default: recordings/NAME of the rig file)",
    )  # fmt: skip
    add_serve_option(parser)
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig is damped."""
    from koop_commission.report import try_report  # slow to import

    if (args.rig is None) == (args.new is None):
        raise ConfigError("name a rig file, or --new FILE to write one")
    if args.new is not None:
        new_rig_file.ask_for_rig(args.new)
        return 0
    rig = rig_file.read(args.rig)
    folder = args.out or RECORDINGS / Path(args.rig).stem
    with (
        resumable(rig, f"./koop commission {args.rig} --out {folder}"),
        served(args.serve, folder / "logs") as announce,
    ):
        code = Commissioning(rig, Path(args.rig), folder, announce).run()
    if (folder / progress.NAME).exists():
        print(try_report(folder))
    return code


class Commissioning:
    """All stages on one rig; the folder notes what is done.

    Parameters
    ----------
    rig, file : RigFile, Path
        The rig and its file.
    folder : Path
        Folder of recordings and results.
    announce : callable
        Receives the name of each stage that begins.
    """

    def __init__(
        self,
        rig: RigFile,
        file: Path,
        folder: Path,
        announce: Callable[[str], object] = lambda line: None,
    ) -> None:
        self._rig, self._folder, self._announce = rig, folder, announce
        self._note = note_of(file)
        copy = folder / RIG
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / NAME).exists() and copy.exists():  # until then the file may be mended
            progress.refuse_other_rig(copy, rig_file.read(copy), rig)
        whole_file.write_bytes(copy, file.read_bytes())

    def run(self) -> int:
        """Do what is left to be done; return the exit code."""
        if not (self._check() and self._excite()):
            return 1
        while True:
            rounds = load_verification(self._folder).finished
            number = len(rounds) + 1
            refused = (self._folder / f"{TUNED}-{number}").exists()
            if rounds and (rounds[-1].damped or number > VERIFICATION.rounds or refused):
                break
            if rounds:
                print(verify.format_round(rounds[-1], self._rig.sense))
                goal = spell_goal(self._rig.sense)
                print(f"not {goal}: {rounds[-1].summary}; tuned again, with these recordings")
                self._set_aside(len(rounds))
            if not self._tune(number):
                if not rounds:
                    return 1
                self._set_aside(number)
                break
            self._begin(f"verify, round {number}")
            verify.verify(self._rig, self._folder, self._note)
        return self._conclude(rounds)

    def _check(self) -> bool:
        self._begin("check")
        if whole_file.read_json(self._folder / NAME).get("fit"):
            print("done before")
            return True
        if bad := check.print_findings(check.check_rig(self._rig, note=self._note)):
            print(f"\nnot fit: {bad} BAD; mend that and run the same command again")
            return False
        whole_file.write_json(self._folder / NAME, {"fit": True})
        return True

    def _excite(self) -> bool:
        self._begin("excite")
        state = progress.load(self._rig, self._folder)
        if state is not None and (state.ended in (KNOWN, FLAT) or state.elapsed >= self._rig.time):
            print("done before")
        else:
            state = excite(self._rig, self._folder, self._note)
        print(describe_result(self._rig, state))
        return state.ended == KNOWN

    def _tune(self, number: int) -> bool:
        self._begin(f"tune, round {number}")
        from koop_tune.tune_folders import tune_folders  # slow to import

        out = self._folder / TUNED
        if (out / CONTROLLER).exists():
            print("done before")
            return True
        rounds = load_verification(self._folder).rounds
        loops = [(self._folder / run.bag).parent for item in rounds for run in item.runs]
        if (slowdown := find_slowdown(rounds)) > 1.0:
            print(f"the rig is taken to be {slowdown:.3g} times slower than its dwell points show")
        settings = TuningSettings(seed=number - 1, slowdown=slowdown)
        return tune_folders(self._rig, [self._folder, *loops], out, settings, self._note)

    def _set_aside(self, number: int) -> None:
        """Keep the controller of a round, or why there is none, under its number."""
        old = self._folder / f"{TUNED}-{number}"
        if not old.exists():
            (self._folder / TUNED).rename(old)

    def _conclude(self, rounds: tuple[Round, ...]) -> int:
        """Put the controller of the best round into ``tuned``, print the verdict."""
        index = kept_index(rounds, self._rig.sense)
        old = self._folder / f"{TUNED}-{index + 1}"
        if old.exists():
            print(f"\nround {index + 1} came nearest to the best: its controller is kept")
            self._set_aside(len(rounds))
            old.rename(self._folder / TUNED)
        verification = verify.judge(self._rig, self._folder, index)
        print(verify.format_verdict(verification, rounds[index], self._rig.sense))
        return 0 if verification.damped else 1

    def _begin(self, stage: str) -> None:
        print(f"\n== {stage}", flush=True)
        self._announce(f"commissioning: {stage}")
