"""``koop tune``: from what ``koop excite`` recorded to a controller."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from koop_lab.commission import progress, rig_file
from koop_lab.commission.features import Bands
from koop_lab.commission.rig_file import RigFile
from koop_lab.identify.from_bags import BagTraining, load_bags, train_from_bags
from koop_lab.identify.samples import StateSpec
from koop_lab.tune.folder import CONTROLLER, FIGURES, MODEL, PICTURE, TUNED
from koop_node.config import ConfigError


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "tune",
        description="Chooses the cost and every constant of the controller from a recording of "
        "'koop excite', and says why and what to expect: the closed loop is simulated, with the "
        "nodes' own kernels, on rigs that the recording may be of. Where the recording shows no "
        "optimum it says what to record next, and returns 1.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="of 'koop commission --new'")
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="FOLDER",
        help="of 'koop excite', or a bag in which theta rested at some values",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the results (default: FOLDER/tuned)"
    )
    parser.add_argument("--state", default="/state:x", metavar="/TOPIC:FIELDS")
    parser.add_argument("--theta", metavar="/TOPIC:FIELD", help="default: /theta:theta")
    parser.add_argument("--seed", type=int, default=0, help="of all random numbers")
    parser.add_argument(
        "--effort", type=float, default=1.0, metavar="X",
        help="of the search, in units of the usual one (about a minute on two cores)",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if there is no optimum to be found."""
    from koop_lab.commission.report import reported  # slow to import

    if not 0.0 < args.effort < 1e3:
        raise ConfigError("--effort: above 0, below 1000")
    folder = args.folders[0]
    out = args.out or folder / TUNED
    done = tune_folders(
        rig_file.read(args.rig), args.folders, out, args.state, args.theta, args.seed, args.effort
    )
    if args.out is None and (folder / progress.NAME).exists():
        print(reported(folder))
    if done:
        print(f"now: ./koop verify {args.rig} {folder}" if args.out is None else
              f"now: ./koop up {out}")  # fmt: skip
    return 0 if done else 1


def tune_folders(
    rig: RigFile,
    folders: Sequence[Path],
    out: Path,
    state: str = "/state:x",
    theta: str | None = None,
    seed: int = 0,
    effort: float = 1.0,
    slower: float = 1.0,
) -> bool:
    """Tune from recordings, write the results and print them; return whether there is an optimum.

    Parameters
    ----------
    rig : RigFile
        The rig.
    folders : sequence of Path
        Of ``koop excite``, or bags.
    out : Path
        Folder of the results; the parameter file is written last.
    state, theta : str
        What they are called in the recordings.
    seed : int
        Of all random numbers.
    effort : float
        Of the search, in units of the usual one.
    slower : float
        By how much the rig follows theta more slowly than its stays say, as a loop has shown.

    Raises
    ------
    ValueError
        If there are results already, or the recordings cannot be used.
    """
    from koop_lab.tune import figures, written  # slow to import
    from koop_lab.tune.picture import draw
    from koop_lab.tune.tuning import NoOptimum, tune

    began = time.monotonic()
    bags, how = bags_of(folders, rig)
    if (out / CONTROLLER).exists():
        raise ConfigError(f"{out / CONTROLLER} is there already: choose another --out")
    training = BagTraining(StateSpec.parse(state), dt=rig.dt, held_out=0.0, theta=theta)
    loaded, training = load_bags(bags, training)
    if loaded.x.shape[0] != len(rig.names):
        raise ConfigError(
            f"{state} has {loaded.x.shape[0]} channels, the rig file {len(rig.names)}"
        )
    out.mkdir(parents=True, exist_ok=True)
    with tqdm(total=100, bar_format="{desc:<40.40} |{bar}| {n:.0f} %", leave=False,
              disable=None) as bar:  # fmt: skip

        def said(what: str, share: float) -> None:
            bar.set_description_str(what, refresh=False)
            bar.update(100.0 * share)

        try:
            found = tune(loaded, rig, training, how, seed, effort, said, slower)
        except NoOptimum as no:
            bar.close()
            draw(no.seen, None, out / PICTURE, f"{folders[0]}: {no.kind}")
            progress.write_whole(out / FIGURES, figures.of_refusal(no))
            print(written.as_table(no.seen))
            print(f"\nno optimum ({no.kind}): {no}\npicture {out / PICTURE}")
            return False
    model = None
    if found.chosen.cost.training is not None:
        model = out / MODEL
        train_from_bags(bags, found.chosen.cost.training).save(model)
    progress.write_whole(out / FIGURES, figures.of_tuning(found, rig, model))
    draw(found.seen, found, out / PICTURE, f"{folders[0]}: {found.chosen.cost.name}")
    progress.write_text(out / CONTROLLER, written.as_parameters(found, rig, model))
    print(written.as_table(found.seen))
    print("\n" + written.as_words(found))
    print(f"\nfound in {time.monotonic() - began:.0f} s; written to {out}")
    return True


def bags_of(folders: Sequence[Path], rig: RigFile) -> tuple[list[Path], Bands | None]:
    """Return the bags of folders, and how the excitation looked at its windows.

    Raises
    ------
    koop_node.config.ConfigError
        If there is nothing.
    """
    bags: list[Path] = []
    how = None
    for folder in folders:
        if not folder.exists():
            raise ConfigError(f"{folder}: is not there")
        known = progress.load(rig, folder) if folder.is_dir() else None
        if known is None:
            bags.append(folder / "bag" if (folder / "bag").is_dir() else folder)
            continue
        how = known.how
        bags += [folder / part / "bag" for part in known.parts if (folder / part / "bag").is_dir()]
        if not known.done:
            print(f"note: {folder}: the excitation has not come to its end")
    if not bags:
        raise ConfigError(f"{folders[0]}: nothing is recorded: koop excite first")
    return bags, how
