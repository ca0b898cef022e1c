"""``koop commission``: from an unknown rig to a damped one; all stages, each where it stopped."""

from __future__ import annotations

import argparse
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from koop_bringup.live.served import add_serve_option, served
from koop_commission.stages import check, new_rig_file, time_scale, verify
from koop_commission.stages.excite import ending, excite
from koop_commission.stages.session import Watch
from koop_commission.theta.commander_client import note_of
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_tune.excitation import progress
from koop_tune.excitation.staircase import unknown_twice
from koop_tune.folder import CONTROLLER, TUNED
from koop_tune.rig import rig_file
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.agreement import ROUNDS, as_predicted, ended, kept_round, slower

NAME, RIG = "commission.json", "rig.yaml"
RECORDINGS = Path("recordings")


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "commission",
        description="Checks a rig, moves theta over its range and records, tunes a controller, "
        "closes the loop and compares it with the prediction; where they disagree it tunes again "
        "with the new recordings, at most three rounds. Whatever ends it, theta goes back to "
        "theta_safe, and the same command goes on where it was. Exit code 0 only if the rig was "
        "damped as predicted. With --new it asks for what a rig file holds, looks at the live "
        "graph and proposes topics and fields; Enter takes what stands in brackets.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", nargs="?", help="of --new")
    parser.add_argument("--new", type=Path, metavar="FILE", help="ask, and write this rig file")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER",
        help="for all that is recorded and found (default: recordings/NAME of the rig file)",
    )  # fmt: skip
    parser.add_argument(
        "--effort", type=float, default=1.0, metavar="X",
        help="of the search for constants, in units of the usual one",
    )  # fmt: skip
    time_scale.add_to(parser)
    add_serve_option(parser)
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig was damped as predicted."""
    from koop_commission.report import reported  # slow to import

    if (args.rig is None) == (args.new is None):
        raise ConfigError("name a rig file, or --new FILE to write one")
    if args.new is not None:
        new_rig_file.ask(args.new)
        return 0
    rig = rig_file.read(args.rig)
    folder = args.out or RECORDINGS / Path(args.rig).stem
    watch = Watch(time_scale.of(args), note_of(args.rig))
    again = f"to go on: ./koop commission {args.rig} --out {folder}{time_scale.words(args)}"
    try:
        with served(args.serve, folder / "logs") as tell:
            code = Commissioning(rig, Path(args.rig), folder, watch, args.effort, tell).run()
    except LiveError as error:
        raise LiveError(f"{error}; {again}") from None
    except KeyboardInterrupt:
        print(f"\ninterrupted: theta is at {rig.theta_safe:g} or was not moved; {again}")
        return 130
    if (folder / progress.NAME).exists():
        print(reported(folder))
    return code


class Commissioning:
    """All stages on one rig; what is done is in the folder.

    Parameters
    ----------
    rig, file : RigFile, Path
        The rig and its file.
    folder : Path
        Of all that is recorded and found.
    watch : Watch
        How the rig is watched.
    effort : float
        Of the search for constants.
    tell : callable
        Is told which stage begins, besides whoever reads the output.
    """

    def __init__(
        self,
        rig: RigFile,
        file: Path,
        folder: Path,
        watch: Watch,
        effort: float = 1.0,
        tell: Callable[[str], object] = lambda line: None,
    ) -> None:
        self._rig, self._folder, self._watch, self._effort = rig, folder, watch, effort
        self._tell = tell
        own, new = folder / RIG, folder / f"{RIG}.new"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not own.exists():
                shutil.copyfile(file, new)
                new.rename(own)
        except OSError as error:
            raise LiveError(progress.not_written(own, error)) from None
        progress.refuse_other_rig(own, rig_file.read(own), rig)

    def run(self) -> int:
        """Do what is left to be done; return the exit code."""
        for stage in (self._check, self._excite):
            if not stage():
                return 1
        while True:
            found = verify.load(self._folder)
            rounds = ended(found["rounds"])
            if rounds and (as_predicted(rounds[-1]) or len(rounds) >= ROUNDS):
                break
            if rounds:
                self._set_aside(len(rounds))
            if not self._tune(found, len(rounds)):
                return 1
            self._head(f"verify, round {len(rounds) + 1}")
            print(verify.shown(verify.verify(self._rig, self._folder, self._watch)))
        which = kept_round(rounds)
        self._keep(which + 1, len(rounds))
        print("\n" + verify.judge(self._rig, self._folder, which)["verdict"])
        return 0 if as_predicted(rounds[which]) else 1

    def _check(self) -> bool:
        self._head("check")
        if progress.noted(self._folder / NAME).get("fit"):
            print("done before")
            return True
        rows = check.live(self._rig, self._watch.scale, True, random.Random(), self._watch.note)
        if bad := check.told(rows):
            print(f"\nnot fit: {bad} BAD; once that is mended, the same command goes on")
            return False
        progress.write_whole(self._folder / NAME, {"fit": True})
        return True

    def _excite(self) -> bool:
        self._head("excite")
        known = progress.load(self._rig, self._folder)
        if known is None or not (known.done or known.elapsed >= self._rig.time):
            watch = self._watch
            found = excite(self._rig, self._folder, watch.scale, 0, watch.note, watch.check)
            print(ending(self._rig, self._folder, found))
            known = found.progress
        else:
            print("done before")
        if unknown_twice(known.visits, len(known.values)):
            print(
                f"\ntheta was not at each value twice in {self._rig.time:g} s: set a longer "
                "'time' in the rig file; then the same command goes on"
            )
            return False
        return True

    def _tune(self, found: dict[str, Any], rounds: int) -> bool:
        self._head(f"tune, round {rounds + 1}")
        from koop_tune.tune_folders import tune_folders  # slow to import

        out = self._folder / TUNED
        if (out / CONTROLLER).exists():
            print("done before")
            return True
        closed = [
            (self._folder / run["bag"]).parent for item in found["rounds"] for run in item["runs"]
        ]
        if (factor := slower(found["rounds"])) > 1.0:
            print(f"the rig counts as {factor:.3g} times as slow as its stays say")
        try:
            return tune_folders(
                self._rig, [self._folder, *closed], out, seed=rounds, effort=self._effort,
                slowdown=factor,
            )  # fmt: skip
        except OSError as error:
            (out / CONTROLLER).unlink(missing_ok=True)  # the last that is written may be torn
            raise LiveError(progress.not_written(out, error)) from None

    def _set_aside(self, number: int) -> None:
        """Keep what was tuned before under the number of its round."""
        old = self._folder / f"{TUNED}-{number}"
        if not old.exists():
            (self._folder / TUNED).rename(old)

    def _keep(self, best: int, last: int) -> None:
        """Put the controller of the best round, which was set aside, in the last one's place."""
        old = self._folder / f"{TUNED}-{best}"
        if best == last or not old.exists():
            return
        print(f"\nround {best} damped the rig best: its controller is kept")
        self._set_aside(last)
        old.rename(self._folder / TUNED)

    def _head(self, what: str) -> None:
        print(f"\n== {what}", flush=True)
        self._tell(f"commissioning: {what}")
